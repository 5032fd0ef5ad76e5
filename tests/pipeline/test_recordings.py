from pathlib import Path

import pytest

from assemblyhands_core.data.digests import FileDigests
from assemblyhands_core.data.label_rows import FROM_FIRST_KEY
from pipeline.config import GcConfig, RigConfig, RunConfig, UserError
from pipeline.executor_config import LocalConfig
from pipeline.graph import ACTION_EDGE, SOURCE_EDGE, TRUTH_EDGE
from pipeline.recordings import Recording, select_recordings

HEADER = "sequence_id,split,calibration,videos,package\n"


def _config(folder: Path, seq: str, **changes: object) -> RunConfig:
    values = {
        "seq": seq, "target": "annotate", "manifest": str(folder / "*.csv"), "release": None,
        "workspace": folder / "work", "run": "",
        "rig": RigConfig(calibration=None, videos=None), "rounds": 3, "gc": GcConfig(keep_runs=1, dry_run=False),
        "executor": LocalConfig(name="serial", num_workers=1, memory_limit="auto"),
    }  # fmt: skip
    return RunConfig(**{**values, **changes})


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name in ("s1", "s2"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "calib.json").write_text("{}")
        for camera in ("camA", "camB"):
            (tmp_path / name / f"{camera}.mp4").write_bytes(camera.encode())
    rows = [f"{name},test,{name}/calib.json,{name}/*.mp4," for name in ("s1", "s2")]
    (tmp_path / "set.csv").write_text(HEADER + "\n".join(rows) + "\n")
    return tmp_path


@pytest.mark.parametrize(
    ("seq", "names"),
    [
        ("s1", ["s1"]),
        ("s2,s1", ["s2", "s1"]),
        ("s*", ["s1", "s2"]),
        ("all", ["s1", "s2"]),
        ("s1,s*", ["s1", "s2"]),
        ("all,-s1", ["s2"]),
        ("-s2, s*", ["s1"]),
        ("-*2", ["s1"]),
    ],
)
def test_names_lists_globs_and_all(folder: Path, seq: str, names: list[str]) -> None:
    assert [recording.sequence_id for recording in select_recordings(_config(folder, seq))] == names


def test_cameras_are_named_by_their_files(folder: Path) -> None:
    recording = select_recordings(_config(folder, "s1"))[0]
    assert recording.videos == {"camA": folder / "s1/camA.mp4", "camB": folder / "s1/camB.mp4"}
    rows = recording.origin_rows(FileDigests(folder / "memory.json"))[SOURCE_EDGE]
    assert [(row["role"], row["name"]) for row in rows] == [
        ("calibration", "calibration"),
        ("video", "camA"),
        ("video", "camB"),
    ]
    assert len({row["sha256"] for row in rows}) == 3


def test_what_is_true_stands_apart_from_what_is_given(folder: Path) -> None:
    known = folder / "s1/truth"
    known.mkdir()
    for name in ("true_joints", "true_instants"):
        (known / f"{name}.parquet").write_bytes(name.encode())
    rows = ("s1,test,s1/calib.json,s1/*.mp4,,s1/truth", "s2,test,s2/calib.json,s2/*.mp4,,")
    (folder / "set.csv").write_text("\n".join([HEADER.strip() + ",ground_truth", *rows]))
    with_truth, without = (
        recording.origin_rows(FileDigests(folder / "memory.json"))
        for recording in select_recordings(_config(folder, "all"))
    )
    assert [(row["role"], row["name"]) for row in with_truth[TRUTH_EDGE]] == [
        ("ground_truth", "true_instants"),
        ("ground_truth", "true_joints"),
    ]
    assert without[TRUTH_EDGE] == () and len(with_truth[SOURCE_EDGE]) == len(without[SOURCE_EDGE]) == 3


@pytest.mark.parametrize("column", ["keypoints", "ground_truth"])
def test_a_folder_that_is_not_there_is_named(folder: Path, column: str) -> None:
    (folder / "set.csv").write_text(f"{HEADER.strip()},{column}\ns1,test,s1/calib.json,s1/*.mp4,,gone\n")
    with pytest.raises(UserError, match=f"sequence s1: the folder of {column} .*gone does not exist"):
        select_recordings(_config(folder, "s1"))


def test_a_rig_of_ones_own_needs_no_manifest(folder: Path) -> None:
    rig = RigConfig(calibration=str(folder / "s1/calib.json"), videos=str(folder / "s1/*.mp4"))
    recordings = select_recordings(_config(folder, "mine", rig=rig))
    assert [recording.sequence_id for recording in recordings] == ["mine"]
    assert list(recordings[0].videos) == ["camA", "camB"]


@pytest.mark.parametrize(
    ("seq", "rig", "message"),
    [
        ("s9", {}, "there is no sequence s9; the manifest has s1, s2"),
        ("all,-s9", {}, "there is no sequence s9; the manifest has s1, s2"),
        ("s1,-s*", {}, r"seq=s1,-s\* leaves out every sequence that it names"),
        ("x", {"calibration": "calib.json"}, r"takes both rig\.calibration=PATH and rig\.videos='GLOB'"),
        ("x", {"calibration": "no.json", "videos": "*.mp4"}, r"sequence x: the calibration no\.json does not exist"),
        ("a/b", {"calibration": "c", "videos": "*.mp4"}, "'a/b' cannot name a sequence"),
        ("../x", {"calibration": "c", "videos": "*.mp4"}, "cannot name a sequence"),
    ],
)
def test_mistakes_are_sentences(folder: Path, seq: str, rig: dict[str, str], message: str) -> None:
    config = _config(folder, seq, rig=RigConfig(**{"calibration": None, "videos": None, **rig}))
    with pytest.raises(UserError, match=message):
        select_recordings(config)


def test_two_cameras_of_one_name_are_refused(folder: Path) -> None:
    (folder / "s2/camA.avi").write_bytes(b"")
    rig = RigConfig(calibration=str(folder / "s1/calib.json"), videos=str(folder / "s2/*"))
    (folder / "s2/camB.avi").write_bytes(b"")
    with pytest.raises(UserError, match="have the same name, so cameras get mixed up"):
        select_recordings(_config(folder, "mine", rig=rig))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("sequence_id,split\ns1,test\n", "has no column calibration, package, videos"),
        (HEADER + "s1,t,a,b,\ns1,t,a,b,\n", "stands in the manifest twice"),
        (HEADER + "../s1,t,a,b,\n", "'../s1' cannot name a sequence"),
        (HEADER + "a\\b,t,a,b,\n", "cannot name a sequence"),
        (HEADER + ".s1,t,a,b,\n", "cannot name a sequence"),
        (HEADER + "s\x1b[2J,t,a,b,\n", r"'s.x1b\[2J' cannot name a sequence"),
        (HEADER + "s" * 121 + ",t,a,b,\n", "cannot name a sequence"),
        (HEADER + "s" * 140_000 + ",t,a,b,\n", r"set.csv: cannot be read as CSV \(field larger than field limit"),
        (HEADER + "s1,t,a,b,\n" + "\n" * 2**23, r"set.csv: has \d+ bytes, more than the 8388608"),
        (HEADER + "s1,t,c.json,*.mp4,unheard_of\n", "packages.json has no package unheard_of"),
    ],
)
def test_a_wrong_manifest_is_named(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "set.csv").write_text(text)
    with pytest.raises(UserError, match=message):
        select_recordings(_config(tmp_path, "s1"))


@pytest.mark.parametrize("row", ["s 1é,test", "s1,../../etc", "s1,/etc"])
def test_rows_of_the_release_cannot_lead_out_of_its_folder(tmp_path: Path, row: str) -> None:
    (tmp_path / "set.csv").write_text(f"{HEADER}{row.replace(' ', '')},,,assemblyhands\n")
    with pytest.raises(UserError, match=r"a (recording|split) is .*: it becomes part of file names"):
        select_recordings(_config(tmp_path, "all", release=tmp_path))


def test_a_manifest_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="names no file"):
        select_recordings(_config(tmp_path, "s1"))


@pytest.mark.parametrize(("label_name", "roles"), [("joint_3d", ["actions"]), (FROM_FIRST_KEY, ["actions", "labels"])])
def test_labels_stand_with_the_actions_where_they_say_at_which_key_pictures_begin(
    tmp_path: Path, label_name: str, roles: list[str]
) -> None:
    for name in ("labels", "actions"):
        (tmp_path / name).write_text(name)
    digests, files = FileDigests(tmp_path / "memory.json"), {"labels": tmp_path / "labels", "label_name": label_name}
    with_actions = Recording("s1", None, {}, actions=tmp_path / "actions", **files)
    assert [row["role"] for row in with_actions.origin_rows(digests)[ACTION_EDGE]] == roles
    assert Recording("s1", None, {}, **files).origin_rows(digests)[ACTION_EDGE] == ()
