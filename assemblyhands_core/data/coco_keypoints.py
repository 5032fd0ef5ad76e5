"""COCO keypoint files of hands: one annotation a hand, 21 keypoints in the order of `hands.joints`.

Boxes are COCO's (left, top, width, height). Visibility is 2 for a joint that is labelled and in the picture, 0 for any
other: whether something hides it is not known.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from jaxtyping import Bool, Float

from assemblyhands_core.data.json_files import (
    FormatError,
    json_list,
    json_object,
    kind_of,
    member,
    numbers,
    read_json_object,
    whole_number,
    write_json,
)
from assemblyhands_core.hands.joints import BONES, HANDS, JOINT_NAMES, NUM_JOINTS, Hand

CATEGORY_IDS: Final[Mapping[Hand, int]] = {"right": 1, "left": 2}
_LABELLED, _UNLABELLED = 2, 0
_MAX_BYTES: Final = 2**28


@dataclass(frozen=True, eq=False)
class CocoHand:
    """A hand in a picture.

    Attributes:
        hand: Which.
        joints_px: Anything where not labelled.
        is_labelled: Known, and in the picture.
        box_px: Left, top, right, bottom.
    """

    hand: Hand
    joints_px: Float[np.ndarray, "joint=21 2"]
    is_labelled: Bool[np.ndarray, "joint=21"]
    box_px: tuple[float, float, float, float]


@dataclass(frozen=True, eq=False)
class CocoPicture:
    """A picture with its hands.

    Attributes:
        file_name: Relative to the pictures' folder.
        size_px: Width and height.
        hands: At most one of each.
    """

    file_name: str
    size_px: tuple[int, int]
    hands: tuple[CocoHand, ...]


def write_coco_keypoints(path: Path, pictures: Sequence[CocoPicture]) -> None:
    """Write a file; ids count from 1 in the order given."""
    annotations = [(number, hand) for number, picture in enumerate(pictures, start=1) for hand in picture.hands]
    write_json(
        path,
        {
            "images": [
                {"id": number, "file_name": p.file_name, "width": p.size_px[0], "height": p.size_px[1]}
                for number, p in enumerate(pictures, start=1)
            ],
            "annotations": [
                _annotation(number, image, hand) for number, (image, hand) in enumerate(annotations, start=1)
            ],
            "categories": [_category(hand) for hand in HANDS],
        },
    )


def read_coco_keypoints(path: Path) -> list[CocoPicture]:
    """Read a file of this form, in the order of its images.

    Tools number categories anew and may list joints in another order: their names count, where the file has them.

    Raises:
        FormatError: It is not as it should be; the message says what and where.
    """
    document = read_json_object(path, _MAX_BYTES)
    categories = _read_categories(document, path)
    hands: dict[int, list[CocoHand]] = {}
    for index, value in enumerate(json_list(member(document, "annotations", str(path)), f"{path}: annotations")):
        where = f"{path}: annotation {index}"
        block = json_object(value, where)
        image = whole_number(member(block, "image_id", where), f"{where}, image_id")
        hands.setdefault(image, []).append(_read_hand(block, categories, where))
    pictures = []
    for index, value in enumerate(json_list(member(document, "images", str(path)), f"{path}: images")):
        where = f"{path}: image {index}"
        block = json_object(value, where)
        number, width, height = (whole_number(member(block, k, where), where) for k in ("id", "width", "height"))
        pictures.append(
            CocoPicture(
                _file_name(member(block, "file_name", where), where), (width, height), tuple(hands.pop(number, ()))
            )
        )
    if hands:
        raise FormatError(f"{path}: annotations are of the image {min(hands)}, which is not in the file; get it again.")
    return pictures


def _file_name(value: object, where: str) -> str:
    if not isinstance(value, str) or not value.isprintable():
        raise FormatError(f"{where}: its file_name is {kind_of(value)}; leave the names of pictures as they are.")
    return value


def _category(hand: Hand) -> dict[str, Any]:
    return {
        "id": CATEGORY_IDS[hand],
        "name": f"{hand}_hand",
        "supercategory": "hand",
        "keypoints": list(JOINT_NAMES),
        "skeleton": [[joint + 1, parent + 1] for joint, parent in BONES],
    }


def _annotation(number: int, image: int, hand: CocoHand) -> dict[str, Any]:
    left, top, right, bottom = hand.box_px
    points = np.where(hand.is_labelled[:, None], hand.joints_px, 0.0)
    visibility = np.where(hand.is_labelled, _LABELLED, _UNLABELLED)
    keypoints = [value for (x, y), v in zip(points.tolist(), visibility.tolist(), strict=True) for value in (x, y, v)]
    return {
        "id": number,
        "image_id": image,
        "category_id": CATEGORY_IDS[hand.hand],
        "keypoints": keypoints,
        "num_keypoints": int(hand.is_labelled.sum()),
        "bbox": [left, top, right - left, bottom - top],
        "area": (right - left) * (bottom - top),
        "iscrowd": 0,
    }


def _read_categories(document: Mapping[str, Any], path: Path) -> dict[int, tuple[Hand, list[int]]]:
    """Return for each category that is a hand which, and at which place of the file's list each of our joints is."""
    if "categories" not in document:
        return {number: (hand, list(range(NUM_JOINTS))) for hand, number in CATEGORY_IDS.items()}
    found: dict[int, tuple[Hand, list[int]]] = {}
    for index, value in enumerate(json_list(document["categories"], f"{path}: categories")):
        where = f"{path}: category {index}"
        block = json_object(value, where)
        number = whole_number(member(block, "id", where), f"{where}, id")
        hand = next((hand for hand in HANDS if block.get("name") == f"{hand}_hand"), None)
        if hand is not None:
            found[number] = hand, _joint_places(block.get("keypoints", []), f"{where}, keypoints")
    return found


def _joint_places(value: object, where: str) -> list[int]:
    names = json_list(value, where)
    if len(names) != NUM_JOINTS or set(map(str, names)) != set(JOINT_NAMES):
        raise FormatError(f"{where}: has to name the {NUM_JOINTS} joints {', '.join(JOINT_NAMES)}.")
    return [names.index(name) for name in JOINT_NAMES]


def _read_hand(block: Mapping[str, Any], categories: Mapping[int, tuple[Hand, list[int]]], where: str) -> CocoHand:
    category = whole_number(member(block, "category_id", where), f"{where}, category_id")
    if category not in categories:
        raise FormatError(f"{where}: category {category} is no hand; there are {sorted(categories)}.")
    hand, places = categories[category]
    keypoints = numbers(member(block, "keypoints", where), (3 * NUM_JOINTS,), f"{where}, keypoints").reshape(-1, 3)[
        places
    ]
    left, top, width, height = numbers(member(block, "bbox", where), (4,), f"{where}, bbox").tolist()
    is_labelled = np.asarray(keypoints[:, 2] > 0)
    points = np.where(is_labelled[:, None], keypoints[:, :2], np.nan)
    return CocoHand(hand, points, is_labelled, (left, top, left + width, top + height))
