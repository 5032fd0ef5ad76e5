"""Hand poses of Assembly101's own tracker, `poses@60fps/<recording>.json` (formats 3.6-3.7).

A list with an entry for every 60 Hz frame. Hand 0 is the left one, the opposite of our order; landmarks are in the
order of `hands.graphs`. An entry that cannot be read is named and its frame is missing; it does not end the reading.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from jaxtyping import Bool, Float32

from assemblyhands_core.data.json_files import (
    MAX_JSON_BYTES,
    FormatError,
    Problems,
    json_list,
    json_object,
    member,
    numbers,
    read_bytes,
    write_json,
)
from assemblyhands_core.hands.graphs import JOINT_OF_LANDMARK
from assemblyhands_core.hands.joints import NUM_BOTH, NUM_JOINTS

NUM_LANDMARKS: Final = 21
HAND_KEYS: Final = ("0", "1")
"""What the files call the left hand and the right one."""
_MAX_FRAMES: Final = 10**6  # 4.6 h, as many as six digits can name


@dataclass(frozen=True, eq=False)
class Assembly101Poses:
    """The poses of one recording; left hand first.

    Attributes:
        landmarks_world_mm: NaN where the file has no pose of a hand.
        confidence: Of the tracker, 0 where there is no pose.
        problems: One sentence for every frame that could not be read; it has no pose.
    """

    landmarks_world_mm: Float32[np.ndarray, "frame hand=2 landmark=21 xyz=3"]
    confidence: Float32[np.ndarray, "frame hand=2"]
    problems: tuple[str, ...] = ()

    def __len__(self) -> int:
        """Return the number of 60 Hz frames."""
        return len(self.confidence)

    def joints(
        self, min_confidence: float = 0.0
    ) -> tuple[Float32[np.ndarray, "frame joint=42 xyz=3"], Bool[np.ndarray, "frame joint=42"]]:
        """Return both hands in our order, right hand first, and which joints are known.

        Args:
            min_confidence: Hands of which the tracker is less sure are missing; 0 keeps all, as the reference does.

        Returns:
            Joints in mm, NaN where missing, like the thumb's CMC always is, which this tracker does not have.
        """
        joints = np.full((len(self), 2, NUM_JOINTS, 3), np.nan, dtype=np.float32)
        joints[:, :, JOINT_OF_LANDMARK] = self.landmarks_world_mm[:, ::-1, : len(JOINT_OF_LANDMARK)]
        joints[self.confidence[:, ::-1] < min_confidence] = np.nan
        both = joints.reshape(-1, NUM_BOTH, 3)
        return both, np.asarray(np.isfinite(both).all(axis=-1))


def read_assembly101_poses(path: Path) -> Assembly101Poses:
    """Read the poses of one recording.

    Raises:
        FormatError: The file is missing, too large, no JSON or no list, or none of its entries can be read.
    """
    data = read_bytes(path, MAX_JSON_BYTES)
    try:
        document = json.loads(data)
    except (RecursionError, ValueError) as error:  # also of bytes that are no text
        raise FormatError(f"{path}: this is no JSON ({error}); get the file again.") from error
    entries = json_list(document, str(path), _MAX_FRAMES)
    landmarks = np.full((len(entries), len(HAND_KEYS), NUM_LANDMARKS, 3), np.nan, dtype=np.float32)
    confidence = np.zeros((len(entries), len(HAND_KEYS)), dtype=np.float32)
    problems = Problems()
    for frame, entry in enumerate(entries):
        with problems.noted():
            found = _hands(entry, f"{path}, frame {frame}")
            for hand, (points, certainty) in found.items():
                landmarks[frame, hand], confidence[frame, hand] = points, certainty
    if entries and len(problems.sentences) == len(entries):
        raise FormatError(f"{path}: none of its {len(entries)} frames can be read: {problems.sentences[0]}")
    return Assembly101Poses(landmarks, confidence, tuple(problems.sentences))


def write_assembly101_poses(path: Path, poses: Assembly101Poses) -> None:
    """Write poses in the form of the data set; hands without a pose are left out of their entry."""
    has_pose = np.isfinite(poses.landmarks_world_mm).all(axis=(2, 3))
    write_json(path, [_entry(poses, has_pose, frame) for frame in range(len(poses))])


def _hands(entry: object, where: str) -> dict[int, tuple[Any, float]]:
    """Return landmarks and confidence of the hands that an entry has."""
    block = json_object(entry, where)
    landmarks = json_object(member(block, "landmarks", where), f"{where}, landmarks")
    certainties = json_object(member(block, "tracking_confidence", where), f"{where}, tracking_confidence")
    return {
        hand: (
            numbers(landmarks[key], (NUM_LANDMARKS, 3), f"{where}, hand {key}"),
            float(numbers(member(certainties, key, where), (), f"{where}, confidence of hand {key}")),
        )
        for hand, key in enumerate(HAND_KEYS)
        if key in landmarks
    }


def _entry(poses: Assembly101Poses, has_pose: Bool[np.ndarray, "frame hand"], frame: int) -> Mapping[str, Any]:
    present = [hand for hand in range(len(HAND_KEYS)) if has_pose[frame, hand]]
    return {
        "landmarks": {HAND_KEYS[hand]: poses.landmarks_world_mm[frame, hand].tolist() for hand in present},
        "tracking_confidence": {HAND_KEYS[hand]: float(poses.confidence[frame, hand]) for hand in present},
    }
