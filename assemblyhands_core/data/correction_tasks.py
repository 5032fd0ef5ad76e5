"""Tasks for annotation tools (CVAT, COCO Annotator): pictures with joints to correct, and what came back.

Tools count pixels from a picture's corner, so that what is in their files is ours plus half a pixel. Only what a person
moved, added or marked as not seen is a correction: what is as it was given is still the pipeline's.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Bool, Float

from assemblyhands_core.data.coco_keypoints import CocoHand, CocoPicture
from assemblyhands_core.data.correction_file import Correction
from assemblyhands_core.data.corrections import NOT_SEEN
from assemblyhands_core.data.json_files import FormatError, counted_problems
from assemblyhands_core.geometry.crops import square_box
from assemblyhands_core.hands.joints import JOINT_NAMES, NUM_JOINTS, Hand

MIN_MOVE_PX: Final = 0.25
"""A joint that is nearer to where it was given has not been moved: tools round."""
_CORNER_PX: Final = 0.5
_BOX_GAMMA: Final = 1.3
_SEEN: Final = 2


@dataclass(frozen=True)
class TaskPicture:
    """A picture of a task.

    Attributes:
        file_name: How the tool's files call it.
        start: The hands in it as they were given to the tool, in its pixels.
    """

    file_name: str
    sequence_id: str
    camera_id: str
    frame: int
    start: CocoPicture


def as_given(
    file_name: str, size_px: tuple[int, int], hands: Mapping[Hand, Float[np.ndarray, "joint=21 2"]]
) -> CocoPicture:
    """Return a picture as tools take it.

    Args:
        file_name: Its name.
        size_px: Its width and height.
        hands: The joints in its pixels, NaN where unknown; those outside are not given, nor hands without any inside.
    """
    found = []
    for hand, joints_px in hands.items():
        is_inside = _is_inside(joints_px, size_px)
        if is_inside.any():
            shifted = joints_px + _CORNER_PX
            found.append(CocoHand(hand, shifted, is_inside, _box(shifted[is_inside], size_px)))
    return CocoPicture(file_name, size_px, tuple(found))


def changes(pictures: Mapping[str, TaskPicture], returned: Sequence[CocoPicture], name: str) -> list[Correction]:
    """Return what a person changed in a task.

    Args:
        pictures: Those of the task, by the last part of their names.
        returned: What the tool wrote.
        name: Of its file, for messages.

    Raises:
        FormatError: A picture is none of the task or has another size, a hand stands in it twice, or a joint lies
            outside.
    """
    found: list[Correction] = []
    with counted_problems() as problems:
        for picture in returned:
            with problems.noted():
                task = pictures.get(picture.file_name.rpartition("/")[2])
                if task is None:
                    raise FormatError(f"{name}: unknown_picture: {picture.file_name} is none of the task's pictures")
                found += _of_picture(task, picture, f"{name}: {picture.file_name}")
    return found


def _of_picture(task: TaskPicture, picture: CocoPicture, where: str) -> Iterator[Correction]:
    if picture.size_px != task.start.size_px:
        raise FormatError(f"{where}: wrong_size: it has {picture.size_px} pixels, {task.start.size_px} were given")
    hands = [hand.hand for hand in picture.hands]
    if len(set(hands)) < len(hands):
        raise FormatError(f"{where}: repeated_hand: a hand stands in it twice; delete one")
    before = {hand.hand: hand for hand in task.start.hands}
    for hand in picture.hands:
        if (hand.is_labelled & ~_is_inside(hand.joints_px - _CORNER_PX, picture.size_px)).any():
            raise FormatError(f"{where}: outside_picture: a joint of the {hand.hand} hand is not in the picture")
        yield from _of_hand(task, before.get(hand.hand), hand)


def _of_hand(task: TaskPicture, before: CocoHand | None, after: CocoHand) -> Iterator[Correction]:
    was = before.is_labelled if before else np.zeros(NUM_JOINTS, dtype=bool)
    moved_px = np.linalg.norm(after.joints_px - before.joints_px, axis=1) if before else np.full(NUM_JOINTS, np.inf)
    is_set = after.is_labelled & (~was | (moved_px >= MIN_MOVE_PX))
    for joint in np.flatnonzero(is_set | (was & ~after.is_labelled)).tolist():
        x_px, y_px = (after.joints_px[joint] - _CORNER_PX).round(3).tolist() if is_set[joint] else (np.nan, np.nan)
        names = task.sequence_id, task.frame, task.camera_id, after.hand, JOINT_NAMES[joint]
        yield Correction(*names, x_px, y_px, _SEEN if is_set[joint] else NOT_SEEN)


def _is_inside(joints_px: Float[np.ndarray, "joint=21 2"], size_px: tuple[int, int]) -> Bool[np.ndarray, " joint=21"]:
    inside = (joints_px >= -_CORNER_PX) & (joints_px <= np.array(size_px) - _CORNER_PX)  # NaN is not
    return np.asarray(inside.all(axis=1))


def _box(points_px: Float[np.ndarray, "joint 2"], size_px: tuple[int, int]) -> tuple[float, float, float, float]:
    center, side = square_box(points_px, _BOX_GAMMA)
    left, top = np.clip(center - side / 2, 0, size_px).tolist()
    right, bottom = np.clip(center + side / 2, 0, size_px).tolist()
    return left, top, right, bottom
