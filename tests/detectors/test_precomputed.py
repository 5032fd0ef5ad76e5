import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from assemblyhands_core.detectors import DetectorError, create_body_detector, create_hand_detector, fingerprint
from assemblyhands_core.hands.body import BODY_KEYPOINT_NAMES

ORDER_25 = (
    "nose neck right_shoulder right_elbow right_wrist left_shoulder left_elbow left_wrist mid_hip right_hip right_knee "
    "right_ankle left_hip left_knee left_ankle right_eye left_eye right_ear left_ear toe1 toe2 heel1 toe3 toe4 heel2"
)
ORDER_18 = (
    "nose neck right_shoulder right_elbow right_wrist left_shoulder left_elbow left_wrist right_hip right_knee "
    "right_ankle left_hip left_knee left_ankle right_eye left_eye right_ear left_ear"
)
BODY_25, COCO_18 = ORDER_25.split(), ORDER_18.split()


def numbered(count: int, confidence: float = 0.8) -> list[float]:
    """Keypoint i lies at (i, 10 i)."""
    return [number for i in range(count) for number in (float(i), 10.0 * i, confidence)]


def write_frame(folder: Path, camera: str, name: str, people: list[dict[str, list[float]]]) -> None:
    (folder / camera).mkdir(parents=True, exist_ok=True)
    (folder / camera / name).write_text(json.dumps({"version": 1.3, "people": people}))


@pytest.mark.parametrize(("names", "count"), [(BODY_25, 25), (COCO_18, 18)])
def test_openpose_bodies_become_coco(tmp_path: Path, names: list[str], count: int) -> None:
    write_frame(tmp_path, "cam01", "x_000000000012_keypoints.json", [{"pose_keypoints_2d": numbered(count)}])
    found = create_body_detector("precomputed", root=tmp_path).detect(None, "cam01", 12)
    places = [names.index(name) for name in BODY_KEYPOINT_NAMES]
    np.testing.assert_array_equal(found.keypoints_px, [[(i, 10 * i) for i in places]])
    np.testing.assert_array_equal(found.confidence, np.full((1, 17), 0.8))


@pytest.mark.parametrize("count", [17, 26, 133])
def test_bodies_that_begin_with_coco_are_taken_as_they_are(tmp_path: Path, count: int) -> None:
    write_frame(tmp_path, "cam01_json", "cam01_000003.json", [{"pose_keypoints_2d": numbered(count)}])
    found = create_body_detector("precomputed", root=tmp_path).detect(None, "cam01", 3)
    np.testing.assert_array_equal(found.keypoints_px[0, :, 0], np.arange(17))


def test_keypoints_without_confidence_are_missing_and_empty_persons_are_none(tmp_path: Path) -> None:
    body = numbered(25)
    body[3 * 4 : 3 * 4 + 3] = [0.0, 0.0, 0.0]  # right wrist
    people = [{"pose_keypoints_2d": body}, {"pose_keypoints_2d": [0.0] * 75}, {"pose_keypoints_2d": []}]
    write_frame(tmp_path, "cam01", "a_000000000000_keypoints.json", people)
    detector = create_body_detector("precomputed", root=tmp_path)
    found = detector.detect(None, "cam01", 0)
    assert len(found.confidence) == 1
    assert np.isnan(found.keypoints_px[0, 10]).all() and np.isfinite(np.delete(found.keypoints_px[0], 10, 0)).all()
    assert detector.detect(None, "cam01", 1).confidence.shape == (0, 17)


def test_openpose_hands_become_tip_to_base_and_the_nearest_is_taken(tmp_path: Path) -> None:
    far = [number + 1000.0 if i % 3 < 2 else 0.9 for i, number in enumerate(numbered(21))]
    people = [{"hand_right_keypoints_2d": numbered(21)}, {"hand_right_keypoints_2d": far}]
    write_frame(tmp_path, "cam01", "a_000000000000_keypoints.json", people)
    hands = create_hand_detector("precomputed", root=tmp_path)
    near = hands.detect(None, "right", "cam01", 0, np.array([0.0, 0.0]))
    assert near is not None and near.keypoints_px[20].tolist() == [0.0, 0.0]  # wrist first in the file
    assert near.keypoints_px[0].tolist() == [4.0, 40.0]  # thumb tip
    surest = hands.detect(None, "right", "cam01", 0)
    assert surest is not None and surest.keypoints_px[20].tolist() == [1000.0, 1000.0]
    assert hands.detect(None, "left", "cam01", 0) is None


def test_hands_within_a_whole_body_are_found(tmp_path: Path) -> None:
    write_frame(tmp_path, "cam01", "a_0.json", [{"pose_keypoints_2d": numbered(133)}])
    hands = create_hand_detector("precomputed", root=tmp_path)
    left, right = hands.detect(None, "left", "cam01", 0), hands.detect(None, "right", "cam01", 0)
    assert left is not None and left.keypoints_px[20, 0] == 91.0
    assert right is not None and right.keypoints_px[20, 0] == 112.0


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        ("{", "this is no such JSON"),
        ("[" * 100_000, "nested without end"),
        ('{"people": [7]}', "it is no OpenPose output"),
        ('{"people": [{"pose_keypoints_2d": [1, 2, 1' + "0" * 400 + "]}]}", "no flat list of x, y, confidence"),
        ("{}", "no list 'people'"),
        ('{"people": [{"pose_keypoints_2d": [1, 2, 3]}]}', "has 1 keypoints; known are 17, 18, 25, 26, 133"),
        ('{"people": [{"pose_keypoints_2d": [1, 2]}]}', "no flat list of x, y, confidence"),
    ],
)
def test_a_bad_json_is_named_with_its_reason(tmp_path: Path, content: str, reason: str) -> None:
    write_frame(tmp_path, "cam01", "a_7.json", [])
    (tmp_path / "cam01" / "a_7.json").write_text(content)
    with pytest.raises(DetectorError, match=reason) as caught:
        create_body_detector("precomputed", root=tmp_path).detect(None, "cam01", 7)
    assert "a_7.json" in str(caught.value)


def test_a_camera_or_root_that_is_not_there_is_named(tmp_path: Path) -> None:
    write_frame(tmp_path, "cam01", "a_7.json", [])
    with pytest.raises(DetectorError, match=r"no folder cam09 or cam09_json for camera cam09: it has cam01"):
        create_body_detector("precomputed", root=tmp_path).detect(None, "cam09", 0)
    with pytest.raises(DetectorError, match="missing, which does not exist"):
        create_hand_detector("precomputed", root=tmp_path / "missing")
    with pytest.raises(DetectorError, match="has no option root"):
        fingerprint("precomputed", {})


def test_two_files_of_one_frame_are_refused(tmp_path: Path) -> None:
    write_frame(tmp_path, "cam01", "a_7.json", [])
    write_frame(tmp_path, "cam01", "b_07.json", [])
    with pytest.raises(DetectorError, match="same frame"):
        create_body_detector("precomputed", root=tmp_path).detect(None, "cam01", 7)


def write_parquet(path: Path, kind: str, kinds: list[object], points: int) -> np.ndarray:
    keypoints = np.arange(len(kinds) * 2 * points, dtype=np.float32).reshape(len(kinds), 2 * points)
    confidence = np.full((len(kinds), points), 0.5, dtype=np.float32)
    confidence[:, 1] = 0.0
    columns = {
        "camera": ["cam01"] * len(kinds),
        "frame": [4] * len(kinds),
        kind: kinds,
        "keypoints_px": pa.FixedSizeListArray.from_arrays(keypoints.ravel(), 2 * points),
        "confidence": pa.array(confidence.tolist()),
    }
    pq.write_table(pa.table(columns), path)
    return keypoints.reshape(len(kinds), points, 2)


def test_parquet_bodies(tmp_path: Path) -> None:
    keypoints = write_parquet(tmp_path / "b.parquet", "person", [1, 0], 17)
    detector = create_body_detector("precomputed", root=tmp_path / "b.parquet")
    found = detector.detect(None, "cam01", 4)
    np.testing.assert_array_equal(found.keypoints_px[:, [0, 2]], keypoints[::-1][:, [0, 2]])  # by person
    assert np.isnan(found.keypoints_px[:, 1]).all()
    assert detector.detect(None, "cam01", 5).confidence.shape == (0, 17)
    with pytest.raises(DetectorError, match="no camera cam02: it has cam01"):
        detector.detect(None, "cam02", 4)


def test_parquet_hands(tmp_path: Path) -> None:
    keypoints = write_parquet(tmp_path / "h.parquet", "hand", ["left", "right"], 21)
    found = create_hand_detector("precomputed", root=tmp_path / "h.parquet").detect(None, "right", "cam01", 4)
    assert found is not None
    np.testing.assert_array_equal(found.keypoints_px[[0, 20]], keypoints[1, [0, 20]])


def test_a_bad_parquet_is_named_with_its_reason(tmp_path: Path) -> None:
    write_parquet(tmp_path / "b.parquet", "person", [0], 16)
    with pytest.raises(DetectorError, match=r"b\.parquet: a row of keypoints_px has 32 numbers instead of 34"):
        create_body_detector("precomputed", root=tmp_path / "b.parquet")
    write_parquet(tmp_path / "h.parquet", "hand", ["both"], 21)
    with pytest.raises(DetectorError, match=r"h\.parquet names a hand 'both'"):
        create_hand_detector("precomputed", root=tmp_path / "h.parquet")
    (tmp_path / "c.parquet").write_bytes(b"PAR1")
    with pytest.raises(DetectorError, match=r"c\.parquet cannot be read as keypoints with the columns camera, frame"):
        create_body_detector("precomputed", root=tmp_path / "c.parquet")
    holes = {"camera": ["c"], "frame": [0], "hand": [None], "keypoints_px": [[0.0] * 42], "confidence": [[0.0] * 21]}
    for table in (holes, {**holes, "hand": ["left"], "keypoints_px": [7]}):
        pq.write_table(pa.table(table), tmp_path / "d.parquet")
        with pytest.raises(DetectorError, match=r"d\.parquet cannot be read as keypoints"):
            create_hand_detector("precomputed", root=tmp_path / "d.parquet")
    with pytest.raises(DetectorError, match="columns camera, frame, person"):
        create_body_detector("precomputed", root=tmp_path / "h.parquet")


def test_the_fingerprint_follows_the_contents(tmp_path: Path) -> None:
    write_frame(tmp_path, "cam01", "a_7.json", [])
    before = fingerprint("precomputed", {"root": str(tmp_path)})
    assert fingerprint("precomputed", {"root": str(tmp_path)}) == before and len(before["sha256"]) == 64
    write_frame(tmp_path, "cam01", "a_8.json", [])
    assert fingerprint("precomputed", {"root": str(tmp_path)}) != before
