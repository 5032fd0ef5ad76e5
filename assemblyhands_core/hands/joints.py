"""The 21 joints of a hand, in the order of the AssemblyHands release.

Convention, stated once here: the right hand is 0–20 and the left hand 21–41 of a two-hand array; within a hand come
thumb, index, middle, ring and pinky, each from **tip to base**, then the wrist. The root of the 3D volume is the middle
finger's base (MCP). Hands are named by the strings ``right`` and ``left``, always in this order.
Source: AssemblyHands toolkit, ``skeleton.txt``; paper, Sec. 3.1 ("third MCP").
"""

from typing import Final, Literal

Hand = Literal["right", "left"]

HANDS: Final[tuple[Hand, Hand]] = ("right", "left")
FINGERS: Final = ("thumb", "index", "middle", "ring", "pinky")
NUM_JOINTS: Final = 21
NUM_BOTH: Final = 2 * NUM_JOINTS
"""Joints of both hands, right hand first."""
WRIST: Final = 20
ROOT: Final = 11

_PHALANX_ENDS: Final = ("tip", "dip", "pip", "mcp")
_THUMB_ENDS: Final = ("tip", "ip", "mcp", "cmc")

JOINT_NAMES: Final[tuple[str, ...]] = (
    *(f"thumb_{end}" for end in _THUMB_ENDS),
    *(f"{finger}_{end}" for finger in FINGERS[1:] for end in _PHALANX_ENDS),
    "wrist",
)

# (child, parent): every joint but the wrist hangs on the next one of its finger, a finger's base on the wrist.
BONES: Final[tuple[tuple[int, int], ...]] = tuple((j, WRIST if j % 4 == 3 else j + 1) for j in range(NUM_JOINTS - 1))

# OpenPose, MediaPipe and MANO-style order (wrist first, then each finger from base to tip), as indices into ours.
WRIST_FIRST_ORDER: Final = (WRIST, *(4 * finger + end for finger in range(5) for end in (3, 2, 1, 0)))
