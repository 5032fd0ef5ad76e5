"""The adapter, with a stand-in module of rtmlib's signatures: no weights, no network."""

import sys
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

from assemblyhands_core.detectors import DetectorError, create_body_detector, create_hand_detector

IMAGE = np.zeros((40, 60, 3), dtype=np.uint8)
IMAGE[..., 0] = 200  # red


class Solution:
    """Called as rtmlib's Body and Hand are: a detector of boxes and a pose model for boxes."""

    made: dict[str, object]
    boxes: list[list[float]]
    keypoints: np.ndarray
    scores: np.ndarray
    images: list[np.ndarray]

    def __init__(
        self, det=None, det_input_size=(640, 640), pose=None, pose_input_size=(288, 384), mode="balanced",
        to_openpose=False, backend="onnxruntime", device="cpu",
    ) -> None:  # fmt: skip
        print("noise")  # noqa: T201 - rtmlib does
        type(self).made = {"mode": mode, "det": det, "backend": backend, "device": device}
        self.det_model = lambda image: np.array(self.boxes).reshape(-1, 4)
        self.pose_model = self._pose

    def _pose(self, image, bboxes=()):
        type(self).images = [image]
        type(self).asked = [list(box) for box in bboxes]
        return self.keypoints, self.scores


@pytest.fixture
def stand_in(monkeypatch: pytest.MonkeyPatch) -> type[Solution]:
    module = ModuleType("rtmlib")
    module.Body = module.Hand = Solution
    monkeypatch.setitem(sys.modules, "rtmlib", module)
    monkeypatch.setitem(sys.modules, "onnxruntime", SimpleNamespace())
    return Solution


def test_bodies_come_surest_first_in_coco_order_from_a_bgr_image(stand_in, capsys) -> None:
    stand_in.boxes = [[0, 0, 10, 10], [10, 10, 30, 30], [0, 0, 5, 5]]
    stand_in.keypoints = np.arange(3 * 17 * 2, dtype=np.float32).reshape(3, 17, 2)
    stand_in.scores = np.array([0.4, 0.9, 0.1], dtype=np.float32)[:, None] * np.ones((3, 17), dtype=np.float32)
    stand_in.scores[1, 16] = 0.0
    found = create_body_detector("rtmlib", max_persons=2, mode="lightweight").detect(IMAGE, "cam01", 0)
    assert stand_in.made == {"mode": "lightweight", "det": None, "backend": "onnxruntime", "device": "cpu"}
    np.testing.assert_array_equal(found.keypoints_px[0, :16], stand_in.keypoints[1, :16])
    assert np.isnan(found.keypoints_px[0, 16]).all() and found.confidence[0, 16] == 0
    np.testing.assert_array_equal(found.keypoints_px[1], stand_in.keypoints[0])
    assert len(found.confidence) == 2
    assert stand_in.images[0][0, 0].tolist() == [0, 0, 200]
    assert capsys.readouterr().out == ""


def test_an_image_without_persons_gives_none_rather_than_the_whole_image(stand_in) -> None:
    stand_in.boxes = []
    stand_in.keypoints, stand_in.scores = np.ones((1, 17, 2)), np.ones((1, 17))
    assert create_body_detector("rtmlib").detect(IMAGE, "cam01", 0).confidence.shape == (0, 17)


def test_the_hand_nearest_to_the_expected_place_is_taken_in_our_order(stand_in) -> None:
    stand_in.boxes = [[0, 0, 10, 10], [40, 20, 60, 40]]
    near_left = np.stack([np.arange(21) / 10, np.full(21, 5.0)], axis=1)
    stand_in.keypoints = np.stack([near_left, near_left + 45.0])
    stand_in.scores = np.stack([np.linspace(0.1, 0.9, 21), np.ones(21)])
    hands = create_hand_detector("rtmlib", mode="lightweight")
    found = hands.detect(IMAGE, "right", "cam01", 0, np.array([0.0, 0.0]))
    assert found is not None
    np.testing.assert_allclose(found.keypoints_px[20], near_left[0])  # wrist
    np.testing.assert_allclose(found.keypoints_px[0], near_left[4])  # thumb tip
    np.testing.assert_allclose(found.confidence[[20, 0]], stand_in.scores[0, [0, 4]])
    assert stand_in.asked == stand_in.boxes
    far = hands.detect(IMAGE, "right", "cam01", 0, np.array([60.0, 40.0]))
    assert far is not None and far.keypoints_px[20].tolist() == [45.0, 50.0]


def test_a_crop_without_a_hand_box_is_taken_as_a_whole(stand_in) -> None:
    stand_in.boxes = []
    stand_in.keypoints, stand_in.scores = np.ones((1, 21, 2)), np.full((1, 21), 0.2)
    found = create_hand_detector("rtmlib").detect(IMAGE, "left", "cam01", 0)
    assert found is not None and found.confidence[0] == 0.2
    assert stand_in.asked == [[0, 0, 60, 40]]


def test_weights_that_cannot_be_fetched_are_answered_with_a_remedy(stand_in, monkeypatch) -> None:
    def offline(**options: object) -> None:
        raise OSError("no route to host")

    monkeypatch.setattr(sys.modules["rtmlib"], "Body", offline)
    with pytest.raises(DetectorError, match=r"no route to host.*options det and pose"):
        create_body_detector("rtmlib")
