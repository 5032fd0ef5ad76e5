import numpy as np
import pytest

from assemblyhands_core.detectors.base import (
    BODY_MIRROR,
    BodyDetections,
    DetectorError,
    HandDetection,
    from_wrist_first,
    masked,
)
from assemblyhands_core.hands.body import BODY_KEYPOINT_NAMES
from assemblyhands_core.hands.joints import JOINT_NAMES


def test_wrist_first_order_becomes_tip_to_base_with_the_wrist_last() -> None:
    # MediaPipe and OpenPose: 0 wrist, 1..4 thumb CMC, MCP, IP, tip, 5 index MCP … 8 index tip, … 20 pinky tip.
    ours = from_wrist_first(np.arange(21))
    assert dict(zip(JOINT_NAMES, ours.astype(int).tolist(), strict=True)) == {
        "thumb_tip": 4,
        "thumb_ip": 3,
        "thumb_mcp": 2,
        "thumb_cmc": 1,
        "index_tip": 8,
        "index_dip": 7,
        "index_pip": 6,
        "index_mcp": 5,
        "middle_tip": 12,
        "middle_dip": 11,
        "middle_pip": 10,
        "middle_mcp": 9,
        "ring_tip": 16,
        "ring_dip": 15,
        "ring_pip": 14,
        "ring_mcp": 13,
        "pinky_tip": 20,
        "pinky_dip": 19,
        "pinky_pip": 18,
        "pinky_mcp": 17,
        "wrist": 0,
    }


def test_the_body_mirror_exchanges_left_and_right_and_keeps_the_nose() -> None:
    names = [BODY_KEYPOINT_NAMES[i] for i in BODY_MIRROR]
    assert names[:5] == ["nose", "right_eye", "left_eye", "right_ear", "left_ear"]
    assert [BODY_MIRROR[i] for i in BODY_MIRROR] == list(range(17))
    assert all(("left" in a) == ("right" in b) for a, b in zip(names, BODY_KEYPOINT_NAMES, strict=True))


def test_masked_makes_unsure_or_infinite_keypoints_missing_and_keeps_the_others() -> None:
    keypoints = np.array([[1.0, 2.0], [3.0, 4.0], [np.inf, 5.0], [6.0, 7.0], [8.0, 9.0]])
    keypoints_px, confidence = masked(keypoints, np.array([0.5, 0.0, 0.9, np.nan, 1.7]))
    np.testing.assert_array_equal(confidence, [0.5, 0.0, 0.0, 0.0, 1.0])
    np.testing.assert_array_equal(keypoints_px[[0, 4]], [[1.0, 2.0], [8.0, 9.0]])
    assert np.isnan(keypoints_px[[1, 2, 3]]).all()


@pytest.mark.usefixtures("unchecked_types")
def test_detections_refuse_wrong_shapes() -> None:
    assert BodyDetections.none().keypoints_px.shape == (0, 17, 2)
    with pytest.raises(DetectorError, match=r"\(2, 17, 2\) and \(2, 17\)"):
        BodyDetections(np.zeros((2, 18, 2)), np.zeros((2, 18)))
    with pytest.raises(DetectorError, match=r"\(21, 2\) and \(21,\)"):
        HandDetection(np.zeros((20, 2)), np.zeros(20))
