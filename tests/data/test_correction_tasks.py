"""What a person changed in a task is told from what was only given; what came back malformed is refused."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from assemblyhands_core.data.coco_keypoints import read_coco_keypoints, write_coco_keypoints
from assemblyhands_core.data.correction_file import Correction
from assemblyhands_core.data.correction_tasks import TaskPicture, as_given, changes
from assemblyhands_core.data.json_files import FormatError
from assemblyhands_core.hands.joints import JOINT_NAMES, WRIST

NAME = "monday--front--000007--0a1b2c3d.jpg"


def _task() -> TaskPicture:
    right = np.stack([np.arange(21) * 4.0 + 10, np.arange(21) * 3.0 + 20], axis=1)
    right[3] = np.nan
    right[4] = (-0.6, 50.0)  # outside, as a picture begins at -0.5
    left = np.full((21, 2), np.nan)
    return TaskPicture(NAME, "monday", "front", 7, as_given(NAME, (120, 100), {"right": right, "left": left}))


@pytest.fixture
def document(tmp_path: Path) -> dict[str, Any]:
    write_coco_keypoints(tmp_path / "task.json", [_task().start])
    read: dict[str, Any] = json.loads((tmp_path / "task.json").read_text())
    return read


def _changes(document: dict[str, Any], folder: Path) -> list[Correction]:
    path = folder / "back.json"
    path.write_text(json.dumps(document))
    return changes({NAME: _task()}, read_coco_keypoints(path), "back.json")


def _set(document: dict[str, Any], joint: int, *values: float) -> None:
    document["annotations"][0]["keypoints"][3 * joint : 3 * joint + 3] = values


def test_tools_get_pixels_from_the_corner_and_no_hand_that_nobody_knows(document: dict[str, Any]) -> None:
    (annotation,) = document["annotations"]
    assert annotation["keypoints"][:3] == [10.5, 20.5, 2] and annotation["num_keypoints"] == 19
    assert annotation["keypoints"][9:15] == [0, 0, 0, 0, 0, 0]
    left, top, width, height = annotation["bbox"]
    assert left == 0 and top >= 0 and left + width <= 120 and top + height <= 100


def test_what_nobody_touched_is_no_correction(document: dict[str, Any], tmp_path: Path) -> None:
    _set(document, 0, 10.6, 20.4, 2)  # tools round
    assert _changes(document, tmp_path) == []


def test_moved_added_and_hidden_joints_are_corrections(document: dict[str, Any], tmp_path: Path) -> None:
    _set(document, 0, 15.5, 25.5, 2)
    _set(document, 3, 33.25, 44.0, 1)
    _set(document, WRIST, 0, 0, 0)
    document["images"][0]["file_name"] = f"default/{NAME}"
    found = {(c.joint, c.x_px, c.y_px, c.visibility) for c in _changes(document, tmp_path) if c.visibility}
    assert found == {(JOINT_NAMES[0], 15.0, 25.0, 2), (JOINT_NAMES[3], 32.75, 43.5, 2)}
    (unseen,) = (c for c in _changes(document, tmp_path) if not c.visibility)
    assert unseen.key == (7, "front", "right", "wrist") and np.isnan(unseen.x_px)


def test_a_hand_that_was_not_given_is_new_and_one_that_is_gone_is_left_alone(
    document: dict[str, Any], tmp_path: Path
) -> None:
    document["annotations"][0]["category_id"] = 2
    found = _changes(document, tmp_path)
    assert len(found) == 19 and {c.hand for c in found} == {"left"}


def test_categories_and_joints_count_by_their_names(document: dict[str, Any], tmp_path: Path) -> None:
    order = np.random.default_rng(0).permutation(21)
    for category in document["categories"]:
        category["id"] += 40
        category["keypoints"] = [category["keypoints"][i] for i in order]
    annotation = document["annotations"][0]
    annotation["category_id"] += 40
    annotation["keypoints"] = np.reshape(annotation["keypoints"], (21, 3))[order].ravel().tolist()
    assert _changes(document, tmp_path) == []


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda d: d["annotations"][0]["keypoints"].pop(), "annotation 0, keypoints: expected 63 numbers"),
        (lambda d: _set(d, 0, float("nan"), 5, 2), "NaN"),
        (lambda d: _set(d, 0, 120.1, 5, 2), "outside_picture: a joint of the right hand"),
        (lambda d: _set(d, 0, 5, -0.1, 2), "outside_picture"),
        (lambda d: d["images"][0].update(file_name="holiday.jpg"), "unknown_picture: holiday.jpg"),
        (lambda d: d["images"][0].update(width=99), r"wrong_size: it has \(99, 100\)"),
        (lambda d: d["categories"][0]["keypoints"].__setitem__(0, "elbow"), "has to name the 21 joints"),
        (lambda d: d["categories"][0]["keypoints"].pop(), "has to name the 21 joints"),
        (lambda d: d["categories"][0].update(name="foot"), "category 1 is no hand"),
        (lambda d: d["annotations"].append({**d["annotations"][0], "id": 99}), "repeated_hand"),
    ],
)
def test_what_is_malformed_is_refused(
    document: dict[str, Any], tmp_path: Path, change: Callable[[Any], Any], reason: str
) -> None:
    change(document)
    with pytest.raises(FormatError, match=reason):
        _changes(document, tmp_path)
