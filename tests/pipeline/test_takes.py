"""What is ordered from the studio, and what has been delivered already."""

from pathlib import Path

import pytest

from assemblyhands_core.data.digests import FileDigests
from assemblyhands_core.data.studio_tables import TAKES
from pipeline.config import ExecutorConfig, GcConfig, RigConfig, RunConfig, UserError
from pipeline.dag import TAKE_EDGE
from pipeline.recordings import select_recordings
from pipeline.takes import absent_takes, select_takes

NAME = "nusar-2021_action_both_1002-c13e_1002_user_id_2022-03-03_140549"
HEADER = "sequence_id,split,calibration,videos,package,rig,duration_s,keypoints"


def config(folder: Path, row: str, **changes: object) -> RunConfig:
    (folder / "set.csv").write_text(f"{HEADER}\n{row}\nreal,demo,calib.json,*.mp4,,,,\n")
    values = {
        "seq": NAME, "target": "simulate", "manifest": str(folder / "set.csv"), "workspace": folder / "work", "run": "",
        "rig": RigConfig(calibration=None, videos=None), "gc": GcConfig(keep_runs=1, dry_run=False),
        "executor": ExecutorConfig(name="serial", num_workers=1, memory_limit="auto"),
    }  # fmt: skip
    return RunConfig(**{**values, **changes})


def row(rig: str = "assembly", duration: str = "2.5") -> str:
    return f"{NAME},test,calib/{NAME}.json,recordings/*.mp4,synthetic,{rig},{duration},keys"


def test_a_row_becomes_an_order(tmp_path: Path) -> None:
    (take,) = select_takes(config(tmp_path, row()))
    rows = take.origin_rows(FileDigests(tmp_path / "memory.json"))[TAKE_EDGE]
    assert TAKES.from_rows(rows).to_pylist() == [
        {"sequence_id": NAME, "split": "test", "rig": "assembly", "duration_s": 2.5}
    ]


@pytest.mark.parametrize(
    ("line", "seq", "message"),
    [
        (row(duration="long"), NAME, "duration_s is 'long', no number"),
        (row(duration="0"), NAME, "above 0"),
        (row(rig="garage"), NAME, "assembly or desktop"),
        (row(), "all", "real: real recordings cannot be simulated"),
    ],
)
def test_what_cannot_be_recorded_is_refused(tmp_path: Path, line: str, seq: str, message: str) -> None:
    with pytest.raises(UserError, match=message):
        select_takes(config(tmp_path, line, seq=seq))


def test_a_take_is_absent_until_its_list_of_files_is_there(tmp_path: Path) -> None:
    both = config(tmp_path, row(), seq="all", target="annotate")
    assert absent_takes(both) == [NAME]
    listing = tmp_path / "work/synthetic/delivered" / f"{NAME}.sha256"
    listing.parent.mkdir(parents=True)
    listing.write_text("")
    assert absent_takes(both) == []
    own = RigConfig(calibration="calib.json", videos="*.mp4")
    assert absent_takes(config(tmp_path, row(), seq="mine", rig=own)) == []


def test_a_recording_comes_with_its_keypoints(tmp_path: Path) -> None:
    root = tmp_path / "work" / "synthetic"
    for name in (f"calib/{NAME}.json", "recordings/a.mp4"):
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text("")
    with pytest.raises(UserError, match=r"folder of keypoints .*keys does not exist"):
        select_recordings(config(tmp_path, row()))
    (root / "keys").mkdir()
    (recording,) = select_recordings(config(tmp_path, row()))
    assert recording.keypoints == root / "keys" and list(recording.videos) == ["a"]
