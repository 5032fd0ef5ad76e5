"""Where files stand, lists of recordings without a person in two of them, and the manifests of synthetic sets."""

import csv
from collections import Counter
from pathlib import Path

import pytest

from assemblyhands_core.data.json_files import FormatError
from assemblyhands_core.data.layout import DatasetLayout, read_split, write_splits
from assemblyhands_core.data.names import parse_recording_name

RECORDINGS = [f"nusar-2021_action_both_{n}-a01_{n}_user_id_2022-03-02_0918{n % 60:02d}" for n in range(1001, 1005)]
MANIFESTS = Path(__file__).resolve().parents[2] / "data_manifests"


def test_files_of_a_recording() -> None:
    layout, name = DatasetLayout(Path("root")), RECORDINGS[0]
    assert layout.calibration(name) == Path(f"root/calib/nimble_json_calib/{name}.json")
    assert layout.video(name, "HMC_84355350_mono10bit") == Path(f"root/recordings/{name}/HMC_84355350_mono10bit.mp4")
    assert layout.annotations("train", "joint_3d") == Path(
        "root/annotations/train/assemblyhands_train_joint_3d_v1-1.json"
    )
    assert layout.exo_calibration(name) == Path(f"root/videos/exo_videos_rectified/{name}/calib.txt")
    assert layout.fine_grained("val", 60) == Path("root/fine-grained-annotations/60fps/val.csv")
    assert layout.ground_truth(name) == Path(f"root/ground_truth/{name}")


def test_names_cannot_leave_the_root() -> None:
    layout = DatasetLayout(Path("root"))
    for ask in (layout.calibration, layout.ground_truth, layout.split, layout.exo_calibration):
        with pytest.raises(ValueError, match="it becomes part of file names"):
            ask("../../etc")
    with pytest.raises(ValueError, match="it becomes part of file names"):
        layout.video(RECORDINGS[0], "..")


def test_splits_round_trip(tmp_path: Path) -> None:
    layout = DatasetLayout(tmp_path)
    write_splits(layout, {"train": [RECORDINGS[2], RECORDINGS[0]], "val": RECORDINGS[1:2], "test": []})
    assert read_split(layout.split("train")) == [RECORDINGS[0], RECORDINGS[2]]
    assert read_split(layout.split("val")) == RECORDINGS[1:2] and read_split(layout.split("test")) == []


def test_nobody_is_in_two_splits(tmp_path: Path) -> None:
    again = RECORDINGS[0].replace("a01", "b02a")
    with pytest.raises(ValueError, match="participant 1001 occurs in the splits train and test"):
        write_splits(DatasetLayout(tmp_path), {"train": RECORDINGS[:2], "test": [again]})
    assert not (tmp_path / "splits").exists()


@pytest.mark.parametrize(
    ("content", "reason"),
    [(b"nusar\n", "line 1: 'nusar' is no recording name"), (b"\xff", "is no text"),
     (f"{RECORDINGS[0]}\n\n{RECORDINGS[0]}\n".encode(), "line 3: .* was named before")],
)  # fmt: skip
def test_bad_lists_are_refused(tmp_path: Path, content: bytes, reason: str) -> None:
    (tmp_path / "train.txt").write_bytes(content)
    with pytest.raises(FormatError, match=f"train.txt.*{reason}"):
        read_split(tmp_path / "train.txt")


def _manifest(name: str) -> list[dict[str, str]]:
    with (MANIFESTS / f"synthetic_{name}.csv").open(newline="") as file:
        return list(csv.DictReader(file))


@pytest.mark.parametrize("name", ["tiny", "small", "test", "desktop", "full"])
def test_manifests_keep_to_the_layout_and_to_one_split_a_person(tmp_path: Path, name: str) -> None:
    rows = _manifest(name)
    splits: dict[str, list[str]] = {}
    for row in rows:
        assert row["calibration"] == row["videos"] == "", "the name decides where files are"
        assert (row["rig"] == "desktop") == (row["split"] == "desktop") and 1 <= float(row["duration_s"]) <= 600
        splits.setdefault(row["split"], []).append(row["sequence_id"])
    write_splits(DatasetLayout(tmp_path), splits)


def test_manifests_have_the_stated_sizes_and_no_name_twice() -> None:
    sets = {name: _manifest(name) for name in ("tiny", "small", "test", "desktop", "full")}
    assert {name: len(rows) for name, rows in sets.items()} == {
        "tiny": 2,
        "small": 26,
        "test": 10,
        "desktop": 3,
        "full": 86,
    }
    names = [row["sequence_id"] for rows in sets.values() for row in rows]
    assert len(set(names)) == len(names)
    # The paper: 62 manually annotated recordings (54 and 8) of 14 people, 20 others (14, 2, 4) of 20 people.
    split_of = {row["sequence_id"]: row["split"] for row in sets["full"]}
    recordings = Counter(split_of.values())
    people = Counter(split for split, _ in {(s, parse_recording_name(n).participant) for n, s in split_of.items()})
    assert recordings == {"manual_train": 54, "manual_test": 8, "train": 14, "val": 2, "test": 4, "desktop": 4}
    assert people == {"manual_train": 12, "manual_test": 2, "train": 14, "val": 2, "test": 4, "desktop": 4}
