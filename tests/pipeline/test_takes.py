"""What is ordered from the studio, and what has been delivered already."""

from pathlib import Path

import pytest

from assemblyhands_core.data.digests import FileDigests
from assemblyhands_core.data.studio_tables import CROP_ORDERS, TAKES
from pipeline.config import GcConfig, RigConfig, RunConfig, UserError
from pipeline.dag import build_dag
from pipeline.executor_config import LocalConfig
from pipeline.graph import CROP_EDGE, TAKE_EDGE
from pipeline.recordings import select_recordings
from pipeline.takes import absent_takes, select_takes
from stages.deliver_recording import DeliverRecordingConfig

NAME = "nusar-2021_action_both_1002-c13e_1002_user_id_2022-03-03_140549"
OTHER = "nusar-2021_action_both_1002-c13e_1002_user_id_2022-03-04_140549"
HEADER = "sequence_id,split,calibration,videos,package,rig,duration_s,rate_hz"


def config(folder: Path, line: str, labelled_every_s: float = 1.0, **changes: object) -> RunConfig:
    (folder / "set.csv").write_text(f"{HEADER}\n{line}\nreal,demo,calib.json,*.mp4,,,,\n")
    values = {
        "seq": NAME, "target": "simulate", "manifest": str(folder / "set.csv"), "release": None,
        "workspace": folder / "work", "run": "",
        "rig": RigConfig(calibration=None, videos=None), "rounds": 3, "gc": GcConfig(keep_runs=1, dry_run=False),
        "executor": LocalConfig(name="serial", num_workers=1, memory_limit="auto"),
    }  # fmt: skip
    found = RunConfig(**{**values, **changes})
    found._dag, found._stages = (
        build_dag(),
        {"deliver_recording": DeliverRecordingConfig(labelled_every_s=labelled_every_s)},
    )
    return found


def row(rig: str = "assembly", duration: str = "2.5", name: str = NAME, split: str = "test", rate: str = "") -> str:
    return f"{name},{split},,,synthetic,{rig},{duration},{rate}"


def deliver(folder: Path, heading: str, *paths: str) -> None:
    root = folder / "work" / "synthetic"
    for path in (*paths, f"delivered/{NAME}.sha256"):
        (root / path).parent.mkdir(parents=True, exist_ok=True)
        (root / path).write_text("")
    lines = [heading, *(f"0  {path}" for path in paths)]
    (root / f"delivered/{NAME}.sha256").write_text("".join(f"{line}\n" for line in lines))


def test_a_row_becomes_an_order(tmp_path: Path) -> None:
    (take,) = select_takes(config(tmp_path, row()))
    origins = take.origin_rows(FileDigests(tmp_path / "memory.json"))
    assert TAKES.from_rows(origins[TAKE_EDGE]).to_pylist() == [
        {"sequence_id": NAME, "rig": "assembly", "duration_s": 2.5, "rate_hz": 30}
    ]
    assert (
        origins[CROP_EDGE] == () and take.heading(config(tmp_path, row())) == "# rig=assembly duration_s=2.5 split=test"
    )
    (slow,) = select_takes(config(tmp_path, row(rate="2")))
    assert slow.rate_hz == 2 and slow.heading(config(tmp_path, row(), 0.2)) == (
        "# rig=assembly duration_s=2.5 rate_hz=2 split=test labelled_every_s=0.2"
    )


def test_crops_are_ordered_for_training_only(tmp_path: Path) -> None:
    line = "crops_train,train,,,crops,assembly,240,"
    (take,) = select_takes(config(tmp_path, line, seq="crops_train", target="train"))
    origins = take.origin_rows(FileDigests(tmp_path / "memory.json"))
    assert CROP_ORDERS.from_rows(origins[CROP_EDGE])["split"].to_pylist() == ["train"] and origins[TAKE_EDGE] == ()
    with pytest.raises(UserError, match=r"of the package crops, but target=simulate takes .* package synthetic"):
        select_takes(config(tmp_path, line, seq="crops_train"))
    with pytest.raises(UserError, match=r"of the package synthetic, but target=train takes .* package crops"):
        select_takes(config(tmp_path, row(), target="train"))


@pytest.mark.parametrize(
    ("line", "seq", "message"),
    [
        (row(duration="long"), NAME, r"set\.csv, sequence .*duration_s is 'long', has to be a number"),
        (row(duration=""), NAME, "duration_s is ''"),
        (row(duration="inf"), NAME, "duration_s is 'inf'"),
        (row(duration="0"), NAME, "above 0"),
        (row(rate="24"), NAME, "rate_hz is '24', has to be one of 1, 2, 3, 5, 6, 10, 15, 30"),
        (row(rig="garage"), NAME, "rig is 'garage', has to be one of assembly, desktop, headset"),
        (row(split=""), NAME, "a split is ''"),
        (row(name="mine"), "mine", r"set\.csv: 'mine' is no recording name"),
        (row(name=NAME.replace("1002", "2005")), NAME.replace("1002", "2005"), "persons from 2000 on are those of"),
        (row(), "all", "real of .*set.csv is of the package none"),
        (f"{row()}\n{row(name=OTHER, split='val')}", "nusar*", "participant 1002 occurs in the splits test and val"),
    ],
)
def test_what_cannot_be_recorded_is_refused(tmp_path: Path, line: str, seq: str, message: str) -> None:
    with pytest.raises(UserError, match=message):
        select_takes(config(tmp_path, line, seq=seq))


def test_a_take_is_absent_until_it_is_delivered_as_ordered(tmp_path: Path) -> None:
    both = config(tmp_path, row(), seq="all", target="annotate")
    assert absent_takes(both) == [NAME]
    deliver(tmp_path, "# rig=assembly duration_s=2.5 split=test", "recordings/a.mp4")
    assert absent_takes(both) == []
    assert absent_takes(config(tmp_path, row(duration="3"), target="annotate")) == [NAME], "another order"
    often = config(tmp_path, row(), 0.2, target="annotate")
    assert absent_takes(often) == [NAME], "other labels"
    (tmp_path / "work/synthetic/recordings/a.mp4").unlink()
    assert absent_takes(both) == [NAME], "a file is gone"
    own = RigConfig(calibration="calib.json", videos="*.mp4")
    assert absent_takes(config(tmp_path, row(), seq="mine", rig=own)) == []


def test_a_recordings_name_decides_where_its_files_are(tmp_path: Path) -> None:
    root = tmp_path / "work" / "synthetic"
    for path in (f"calib/nimble_json_calib/{NAME}.json", f"recordings/{NAME}/a_rgb.mp4", f"recordings/{NAME}/HMC.mp4"):
        (root / path).parent.mkdir(parents=True, exist_ok=True)
        (root / path).write_text("")
    with pytest.raises(UserError, match=r"folder of ground_truth .*does not exist"):
        select_recordings(config(tmp_path, row()))
    (root / "ground_truth" / NAME).mkdir(parents=True)
    (recording,) = select_recordings(config(tmp_path, row()))
    assert recording.ground_truth == root / "ground_truth" / NAME and list(recording.videos) == ["a_rgb"]
    assert recording.keypoints is None and recording.detector == "learned", "mediapipe knows real hands"
