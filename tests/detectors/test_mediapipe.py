import gc
from types import SimpleNamespace

import numpy as np
import pytest

from assemblyhands_core.detectors import DetectorError, create_body_detector, create_hand_detector, fingerprint
from assemblyhands_core.detectors.mediapipe import MediapipeBody, MediapipeHands, body_from_landmarks, paint_over

pytest.importorskip("mediapipe", reason="mediapipe is not installed")

# BlazePose's own numbering of the landmarks that COCO knows, from its documentation.
BLAZEPOSE = {
    "nose": 0,
    "left_eye": 2,
    "right_eye": 5,
    "left_ear": 7,
    "right_ear": 8,
    "left_shoulder": 11,
    "right_shoulder": 12,
    "left_elbow": 13,
    "right_elbow": 14,
    "left_wrist": 15,
    "right_wrist": 16,
    "left_hip": 23,
    "right_hip": 24,
    "left_knee": 25,
    "right_knee": 26,
    "left_ankle": 27,
    "right_ankle": 28,
}


def landmarks(places: np.ndarray, visibility: np.ndarray) -> list[SimpleNamespace]:
    return [SimpleNamespace(x=x, y=y, visibility=v) for (x, y), v in zip(places, visibility, strict=True)]


def test_bodies_are_mapped_to_coco_and_pixel_centres() -> None:
    places = np.stack([np.arange(33) / 40, np.arange(33) / 80], axis=1)
    visibility = np.linspace(0.1, 0.9, 33)
    keypoints_px, confidence = body_from_landmarks(landmarks(places, visibility), 400, 800)
    source = np.array(list(BLAZEPOSE.values()))
    # x of landmark i: i / 40 of 400 px is 10 i, and the image's left edge lies at -0.5.
    np.testing.assert_allclose(keypoints_px, np.stack([10.0 * source - 0.5, 10.0 * source - 0.5], axis=1))
    np.testing.assert_allclose(confidence, visibility[source])


def test_landmarks_outside_the_image_are_missing() -> None:
    places = np.full((33, 2), 0.5)
    places[15] = (1.01, 0.5)  # left wrist
    places[16] = (1.0, 0.0)  # right wrist, on the very edge
    keypoints_px, confidence = body_from_landmarks(landmarks(places, np.ones(33)), 100, 100)
    assert np.isnan(keypoints_px[9]).all() and confidence[9] == 0
    np.testing.assert_allclose(keypoints_px[10], [99.5, -0.5])
    assert confidence[10] == 1 and confidence.sum() == 16


def test_painting_over_covers_the_limbs_and_leaves_the_rest() -> None:
    image = np.full((200, 200, 3), 255, dtype=np.uint8)
    person = np.full((17, 2), np.nan)
    person[[5, 7, 9]] = [[50, 50], [50, 90], [50, 130]]  # left arm, straight down: its extent is 80 px
    painted = paint_over(image, person)
    assert (painted[60:130:10, 50] == 128).all()
    # Lines are 0.14 * 80 = 11 px wide, so nothing farther than 11 px (the discs) from the arm changes.
    assert (painted[:, 63:] == 255).all() and (painted[:, :38] == 255).all() and (painted[143:] == 255).all()
    assert (image == 255).all()


def test_a_blank_image_has_nobody_and_the_same_image_gives_the_same_answer() -> None:
    body, hands = create_body_detector("mediapipe"), create_hand_detector("mediapipe")
    blank = np.full((256, 256, 3), 200, dtype=np.uint8)
    assert body.detect(blank, "cam01", 0).keypoints_px.shape == (0, 17, 2)
    assert hands.detect(blank, "right", "cam01", 0) is None


def test_graphs_are_closed_with_their_detectors() -> None:
    body = MediapipeBody()
    pose = body._pose
    assert pose._graph is not None
    del body
    gc.collect()
    assert pose._graph is None, "MediaPipe's own sign of a closed solution"
    hands = MediapipeHands()
    hands.detect(np.full((64, 64, 3), 200, dtype=np.uint8), "right", "cam01", 0)
    graph, packets = hands._model._graph, hands._model._packets
    del hands
    gc.collect()
    with pytest.raises((RuntimeError, ValueError)):
        graph.add_packet_to_input_stream("image", packets.create_int(1).at(10**6))


def test_a_hand_detection_does_not_depend_on_what_was_looked_at_before() -> None:
    noise = np.random.default_rng(0).integers(0, 255, (3, 64, 64, 3), dtype=np.uint8)
    hands = create_hand_detector("mediapipe", min_confidence=0.0)
    first, *_, again = [hands.detect(noise[i], "left", "cam01", 0) for i in (0, 1, 2, 0)]
    other = create_hand_detector("mediapipe", min_confidence=0.0).detect(noise[0], "left", "cam01", 9)
    assert first is not None and again is not None and other is not None
    np.testing.assert_array_equal(first.keypoints_px, again.keypoints_px)
    np.testing.assert_array_equal(first.keypoints_px, other.keypoints_px)
    np.testing.assert_array_equal(first.confidence, other.confidence)


def test_the_fingerprint_names_the_version_and_the_models() -> None:
    found = fingerprint("mediapipe", {"max_persons": 2})
    assert found["mediapipe"].startswith("0.10")
    models = {name: digest for name, digest in found.items() if name.endswith(".tflite")}
    assert len(models) == 4 and all(len(digest) == 64 for digest in models.values())
    assert fingerprint("mediapipe", {}) == found


@pytest.mark.usefixtures("unchecked_types")
def test_what_cannot_be_done_is_said() -> None:
    with pytest.raises(DetectorError, match="complexity 1, not 2"):
        create_body_detector("mediapipe", model_complexity=2)
    hands = create_hand_detector("mediapipe")
    with pytest.raises(DetectorError, match="cam01 frame 3, got none"):
        hands.detect(None, "right", "cam01", 3)
    with pytest.raises(DetectorError, match=r"got \(8, 8, 3\) float64"):
        hands.detect(np.zeros((8, 8, 3)), "right", "cam01", 3)
