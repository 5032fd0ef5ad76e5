"""How much of each bone's motion every point of the skin follows.

Linear blend skinning with helper bones: around each joint the skin passes from the bone before to a frame half way
through the bend and on to the bone beyond. Each blend then spans half the angle, which keeps 91 % of a joint's
thickness at 100° where plain blending keeps 64 % (cos 25° and cos 50°), and stays linear and fast.
"""

from itertools import pairwise
from typing import Final

import numpy as np
from jaxtyping import Float64

from assemblyhands_core.hands.kinematics import FRAMES_PER_FINGER, HandSkeleton
from assemblyhands_core.synthetic.hand_field import template_frames

NUM_BONES: Final = 5 * FRAMES_PER_FINGER + 1
"""The frames of all fingers in the order of `finger_frames`, then the stump of the forearm."""
FOREARM: Final = NUM_BONES - 1

# Half the length over which the skin passes from one bone to the next: (thumb, fingers) × (base, middle, distal).
_TRANSITION_MM: Final = ((17.0, 12.0, 10.0), *((15.0, 10.5, 8.0),) * 4)
# A finger's share of a point falls with this power of its distance from the finger's bones: gently in the palm, where
# the skin is one, steeply beyond the webs, where each finger moves alone.
_PALM_POWER: Final = 4.0
_FINGER_POWER: Final = 26.0
_WEB_MM: Final = ((0.55, 1.0), *((0.20, 0.62),) * 4)
_FOREARM_MM: Final = (-22.0, 8.0)


def skin_weights(vertices_mm: Float64[np.ndarray, "vertex 3"]) -> Float64[np.ndarray, "vertex 36"]:
    """Return the weights of all bones for points on the template's skin; each row sums to one."""
    frames = template_frames()
    share = finger_shares(vertices_mm)
    chains = [share[:, finger, None] * _chain_weights(vertices_mm, finger, frames[finger]) for finger in range(5)]
    arm = smooth_step(vertices_mm[:, 1], _FOREARM_MM[1], _FOREARM_MM[0])[:, None]
    return np.concatenate([(1.0 - arm) * np.concatenate(chains, axis=1), arm], axis=1)


def finger_shares(vertices_mm: Float64[np.ndarray, "vertex 3"]) -> Float64[np.ndarray, "vertex 5"]:
    """Return to which finger (with its metacarpal) points belong; rows sum to one."""
    frames, lengths = template_frames(), HandSkeleton.average().phalanges_mm
    distance, freedom = np.empty((len(vertices_mm), 5)), np.empty((len(vertices_mm), 5))
    for finger in range(5):
        tip = frames[finger, 6, :3, 3] + lengths[finger, 2] * frames[finger, 6, :3, 1]
        chain = np.concatenate([frames[finger, 2::2, :3, 3], tip[None]])
        if finger > 0:
            chain = np.concatenate([0.3 * chain[:1], chain])
        pieces = [_segment_distance_mm(vertices_mm, a, b) for a, b in pairwise(chain)]
        distance[:, finger] = np.min(pieces, axis=0)
        along = (vertices_mm - frames[finger, 2, :3, 3]) @ frames[finger, 2, :3, 1] / lengths[finger, 0]
        freedom[:, finger] = smooth_step(along, *_WEB_MM[finger])
    nearest = distance.argmin(axis=1)[:, None]
    power = _PALM_POWER + (_FINGER_POWER - _PALM_POWER) * np.take_along_axis(freedom, nearest, axis=1)
    closeness = (np.take_along_axis(distance, nearest, axis=1) / distance) ** power
    return np.asarray(closeness / closeness.sum(axis=1, keepdims=True))


def smooth_step(values: Float64[np.ndarray, "*batch"], zero_at: float, one_at: float) -> Float64[np.ndarray, "*batch"]:
    """Rise from 0 to 1 with level ends: 3 t² - 2 t³ of the share of the way from one value to the other."""
    share = np.clip((values - zero_at) / (one_at - zero_at), 0.0, 1.0)
    return np.asarray(share * share * (3.0 - 2.0 * share))


def _chain_weights(
    vertices_mm: Float64[np.ndarray, "vertex 3"], finger: int, frames: Float64[np.ndarray, "7 4 4"]
) -> Float64[np.ndarray, "vertex 7"]:
    """Weights of one finger's seven frames, as if the point belonged to this finger alone."""
    weights = np.zeros((len(vertices_mm), FRAMES_PER_FINGER))
    remaining = np.ones(len(vertices_mm))
    for joint, width in enumerate(_TRANSITION_MM[finger]):
        half = frames[2 * joint + 1]
        along = (vertices_mm - half[:3, 3]) @ half[:3, 1]
        entered, left = smooth_step(along, -width, 0.0), smooth_step(along, 0.0, width)
        weights[:, 2 * joint] += remaining * (1.0 - entered)
        weights[:, 2 * joint + 1] += remaining * (entered - left)
        remaining = remaining * left
    weights[:, -1] += remaining
    return weights


def _segment_distance_mm(
    points_mm: Float64[np.ndarray, "point 3"], start_mm: Float64[np.ndarray, "3"], end_mm: Float64[np.ndarray, "3"]
) -> Float64[np.ndarray, " point"]:
    axis = end_mm - start_mm
    share = np.clip((points_mm - start_mm) @ axis / (axis @ axis), 0.0, 1.0)
    return np.asarray(np.linalg.norm(points_mm - start_mm - share[:, None] * axis, axis=1))
