"""`ego_data`: images with the boxes of their hands, as the release has them."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from assemblyhands_core.data.assemblyhands_images import EgoImage, ego_image_file, read_ego_images, write_ego_images
from assemblyhands_core.data.json_files import FormatError

RECORDING = "nusar-2021_action_both_1001-c09a_1001_user_id_2022-03-02_091830"


def _image(frame: int = 168, right: bool = True, left: bool = True) -> EgoImage:
    is_valid = np.zeros((2, 21), dtype=bool)
    is_valid[0, :20] = right
    boxes = ({"right": (10.5, 20.0, 110.25, 99.0)} if right else {}) | (
        {"left": (300.0, 1.0, 420.0, 90.0)} if left else {}
    )
    file_name = ego_image_file("train", RECORDING, "84355350_mono10bit", frame)
    return EgoImage(RECORDING, "HMC_84355350", frame, file_name, (636, 480), boxes, is_valid)


def test_an_image_as_the_release_has_it(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    write_ego_images(path, [_image(), _image(170, left=False)])
    document = json.loads(path.read_text())
    assert document["images"][0] == {
        "id": 0, "seq_name": RECORDING, "camera": "HMC_84355350", "frame_idx": 168, "width": 636, "height": 480,
        "file_name": f"ego_images_rectified/train/{RECORDING}/HMC_84355350_mono10bit/000168.jpg", "timestamp": 2.8,
    }  # fmt: skip
    first, second = document["annotations"]
    assert first["bbox"] == {"right": [10.5, 20.0, 110.25, 99.0], "left": [300.0, 1.0, 420.0, 90.0]}
    assert second["bbox"]["left"] is None and second["image_id"] == 1
    assert first["joint_valid"] == [1] * 20 + [0] * 22


def test_images_round_trip(tmp_path: Path) -> None:
    images = [_image(2 * number, right=number % 2 == 0, left=number % 3 == 0) for number in range(6)]
    write_ego_images(tmp_path / "a.json", images)
    read = read_ego_images(tmp_path / "a.json")
    for image, again in zip(images, read, strict=True):
        assert (again.recording, again.camera_id, again.frame_60hz) == (RECORDING, "HMC_84355350", image.frame_60hz)
        assert (again.file_name, again.size_px, again.box_px) == (image.file_name, image.size_px, image.box_px)
        assert (again.is_valid == image.is_valid).all()


def test_an_image_without_annotation_has_no_hand(tmp_path: Path) -> None:
    write_ego_images(tmp_path / "a.json", [_image()])
    document = json.loads((tmp_path / "a.json").read_text()) | {"annotations": []}
    (tmp_path / "a.json").write_text(json.dumps(document))
    (image,) = read_ego_images(tmp_path / "a.json")
    assert not image.box_px and not image.is_valid.any()


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda d: d.pop("annotations"), "lacks 'annotations'"),
        (lambda d: d.update(images={}), "images: expected a JSON list"),
        (lambda d: d["images"].append(d["images"][0]), "image 1: the id 0 is an earlier image's"),
        (lambda d: d["images"][0].update(id="0"), "image 0, id: expected a whole number"),
        (lambda d: d["images"][0].update(width=0), "size: expected a whole number from 1"),
        (lambda d: d["images"][0].update(height=10**9), "size: expected a whole number from 1"),
        (lambda d: d["images"][0].update(frame_idx=1.5), "frame_idx: expected a whole number"),
        (lambda d: d["images"][0].update(file_name="../../x.jpg"), "file_name is '../../x.jpg'"),
        (lambda d: d["images"][0].update(file_name="/etc/passwd"), "file_name is '/etc/passwd'"),
        (lambda d: d["images"][0].pop("seq_name"), "lacks 'seq_name'"),
        (lambda d: d["annotations"][0].update(image_id=5), "its image 5 is not in the file"),
        (lambda d: d["annotations"].append(d["annotations"][0]), "its image 0 was annotated before"),
        (lambda d: d["annotations"][0]["bbox"].update(right=[1, 2, 3]), "right hand: expected 4 numbers"),
        (lambda d: d["annotations"][0]["bbox"].update(left=[9, 2, 3, 4]), "is not left, top, right, bottom"),
        (lambda d: d["annotations"][0]["bbox"].update(left=[1, 2, float("nan"), 4]), "NaN"),
        (lambda d: d["annotations"][0].update(joint_valid=[1] * 21), "joint_valid: expected 42 numbers"),
    ],
)
def test_bad_files_are_refused(tmp_path: Path, change: Callable[[Any], Any], reason: str) -> None:
    path = tmp_path / "a.json"
    write_ego_images(path, [_image()])
    document = json.loads(path.read_text())
    change(document)
    path.write_text(json.dumps(document))
    with pytest.raises(FormatError, match=f"a.json.*{reason}"):
        read_ego_images(path)
