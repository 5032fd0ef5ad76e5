"""COCO files of hands: what was written is read again, and a COCO reader finds what it expects."""

import json
from pathlib import Path

import numpy as np
import pytest

from assemblyhands_core.data.coco_keypoints import CocoHand, CocoPicture, read_coco_keypoints, write_coco_keypoints
from assemblyhands_core.data.json_files import FormatError
from assemblyhands_core.hands.joints import JOINT_NAMES


def _pictures() -> list[CocoPicture]:
    points = np.arange(42, dtype=np.float64).reshape(21, 2) + 0.25
    is_labelled = np.arange(21) != 4
    right = CocoHand("right", points, is_labelled, (1.0, 2.0, 31.5, 44.0))
    left = CocoHand("left", points + 100.0, np.ones(21, dtype=bool), (101.0, 100.0, 141.0, 142.0))
    return [CocoPicture("a/000001.jpg", (636, 480), (right, left)), CocoPicture("a/000002.jpg", (636, 480), ())]


def test_what_is_written_is_read_again(tmp_path: Path) -> None:
    path = tmp_path / "coco.json"
    write_coco_keypoints(path, _pictures())
    first, second = read_coco_keypoints(path)
    assert (first.file_name, first.size_px, second.hands) == ("a/000001.jpg", (636, 480), ())
    for found, expected in zip(first.hands, _pictures()[0].hands, strict=True):
        assert (found.hand, found.box_px) == (expected.hand, expected.box_px)
        assert np.array_equal(found.is_labelled, expected.is_labelled)
        assert np.array_equal(found.joints_px[found.is_labelled], expected.joints_px[expected.is_labelled])
        assert np.isnan(found.joints_px[~found.is_labelled]).all()


def test_the_file_is_cocos(tmp_path: Path) -> None:
    path = tmp_path / "coco.json"
    write_coco_keypoints(path, _pictures())
    document = json.loads(path.read_text())
    right = document["annotations"][0]
    assert right["bbox"] == [1.0, 2.0, 30.5, 42.0] and right["area"] == pytest.approx(30.5 * 42.0)
    assert right["num_keypoints"] == 20 and right["keypoints"][:3] == [0.25, 1.25, 2] and len(right["keypoints"]) == 63
    assert right["keypoints"][12:15] == [0.0, 0.0, 0], "a joint that is not labelled"
    categories = {block["id"]: block for block in document["categories"]}
    assert categories[right["category_id"]]["name"] == "right_hand"
    assert categories[1]["keypoints"] == list(JOINT_NAMES) and len(categories[1]["skeleton"]) == 20
    assert min(min(pair) for pair in categories[1]["skeleton"]) == 1, "COCO counts keypoints from 1"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"category_id": 7}, r"annotation 0: category 7 is no hand"),
        ({"keypoints": [1.0]}, r"annotation 0, keypoints"),
        ({"image_id": 9}, r"annotations are of the image 9"),
    ],
)
def test_odd_files_are_refused(tmp_path: Path, change: dict[str, object], message: str) -> None:
    path = tmp_path / "coco.json"
    write_coco_keypoints(path, _pictures())
    document = json.loads(path.read_text())
    document["annotations"][0].update(change)
    path.write_text(json.dumps(document))
    with pytest.raises(FormatError, match=message):
        read_coco_keypoints(path)


@pytest.mark.parametrize("name", [7, None, "a\x00b.jpg", "\ud800.jpg", "\x1b[2J.jpg"])
def test_names_of_pictures_are_text_that_can_be_said(tmp_path: Path, name: object) -> None:
    path = tmp_path / "coco.json"
    write_coco_keypoints(path, _pictures())
    document = json.loads(path.read_text())
    document["images"][0]["file_name"] = name
    path.write_text(json.dumps(document))
    with pytest.raises(FormatError, match=r"image 0: its file_name is .*; leave the names of pictures as they are"):
        read_coco_keypoints(path)
