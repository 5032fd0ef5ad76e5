"""What a user who makes a mistake sees: one sentence, the right exit code, no traceback."""

import json
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import pytest
from command_line import Outcome, pipeline, run_record
from tiny_recording import write_recording

from pipeline.config import CONF_FOLDER

# The name of a case → the arguments, with {calibration} and {videos} for the recording's, and parts of the sentence.
REFUSED: dict[str, tuple[list[str], list[str]]] = {
    "unknown parameter": (
        ["triangulate.max_reprojektion_px=8"],
        ["there is no parameter triangulate.max_reprojektion_px", "did you mean triangulate.max_reprojection_px?"],
    ),
    "unknown sequences": (
        ["seq=nobody,nothing"],
        ["there is no sequence nobody", "pose2sim_single", "rig.calibration"],
    ),
    "absent calibration": (
        ["annotate", "rig.calibration=/no/rig.json", "rig.videos={videos}", "seq=tiny"],
        ["sequence tiny: the calibration /no/rig.json does not exist"],
    ),
    "no calibration": (["rig.videos={videos}"], ["both rig.calibration=PATH and rig.videos='GLOB'"]),
    "no video": (
        ["rig.calibration={calibration}", "rig.videos=/no [such] folder (1)/*.mp4", "seq=tiny"],
        ["sequence tiny: no video matches /no [such] folder (1)/*.mp4"],
    ),
    "wrong type": (["plan", "triangulate.min_views=two"], ["triangulate.min_views='two' is not possible", "integer"]),
    "out of bounds": (["triangulate.min_views=1"], ["triangulate.min_views=1 is not possible", "equal to 2"]),
    "a sweep without -m": (["ingest.chunk_frames=8,16"], ["ingest.chunk_frames='8,16' is not possible", "integer"]),
    "unknown command": (["anotate"], ["there is no command anotate", "annotate, smooth, evaluate, doctor"]),
    "unknown target": (
        ["target=round_9"],
        ["target=round_9 is unknown (did you mean round_3?)", "annotate, smooth, evaluate, doctor"],
    ),
    "unknown executor": (["executor=quick"], ["there is no executor/quick", "local, serial"]),
    "a word too many": (["annotate", "seq=tiny", "quickly"], ["quickly is no parameter=value"]),
    "a name that is none": (
        ["rig.calibration={calibration}", "rig.videos={videos}", "seq=../tiny"],
        ["'../tiny' cannot name a sequence"],
    ),
    "a run outside runs": (
        ["annotate", "seq=tiny", "run=../store"],
        ["run=../store cannot name a run", "work/runs", "the folder's name alone"],
    ),
    "a run called latest": (
        ["annotate", "seq=tiny", "run=latest"],
        ["run=latest cannot name a new run", "another name"],
    ),
    "nothing to correct": (["correct", "corrected="], ["name the COCO keypoints file", "corrected=PATH"]),
    "absent manifest": (["manifest=/no/manifest.csv"], ["manifest=/no/manifest.csv names no file"]),
    "unusable workspace": (["workspace=/dev/null/work"], ["/dev/null/work"]),
    "nothing to look at": (["plan", "seq=all", "manifest={calibration}"], ["has no column", "sequence_id"]),
    "a sweep of mistakes": (
        ["seq=nobody,nothing", "-m"],
        ["there is no sequence nobody", "there is no sequence nothing"],
    ),
}
SHOWN = {"help": ["--help"], "parameters": ["--cfg", "job"], "parameters as set": ["seq=a,b", "--cfg", "job"]}


@pytest.fixture(scope="module")
def outcomes(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Outcome]:
    """Run all commands, two at a time: each is mostly the start of Python."""
    folder = tmp_path_factory.mktemp("mistakes")
    recording = write_recording(folder / "tiny")
    places = {"calibration": str(recording.calibration), "videos": f"{recording.folder}/videos/*.mp4"}
    commands = {name: [a.format_map(places) for a in arguments] for name, (arguments, _) in REFUSED.items()} | SHOWN

    def run(arguments: list[str]) -> Outcome:
        return pipeline(*arguments, workspace=folder / "work")

    with ThreadPoolExecutor(2) as pool:
        return dict(zip(commands, pool.map(run, commands.values()), strict=True))


@pytest.mark.parametrize("case", REFUSED)
def test_a_mistake_gets_a_sentence(outcomes: dict[str, Outcome], case: str) -> None:
    outcomes[case].assert_refused(2, "error: ", *REFUSED[case][1])
    num_lines = len(outcomes[case].err.splitlines())
    assert num_lines == (2 if case == "a sweep of mistakes" else 1), outcomes[case].err


def test_help_names_commands_and_results(outcomes: dict[str, Outcome]) -> None:
    shown = outcomes["help"].assert_done().out
    assert all(word in shown for word in ("annotate", "doctor", "plan", "gc", "seq=NAME", "load("))


def test_all_parameters_can_be_seen(outcomes: dict[str, Outcome]) -> None:
    shown = outcomes["parameters"].assert_done().out
    for file in (CONF_FOLDER / "stage").glob("*.yaml"):
        assert f"\n{file.stem}:" in f"\n{shown}"
    assert "max_reprojection_px: 20.0" in shown
    assert "seq: a,b" in outcomes["parameters as set"].assert_done().out


_TOML = """
[front]
size = [320, 240]
matrix = [[260.0, 0.0, 159.5], [0.0, 260.0, 119.5], [0.0, 0.0, 1.0]]
distortions = [0.0, 0.0, 0.0, 0.0, 0.0]
rotation = [nan, 0.0, 0.0]
translation = [0.0, 0.0, 0.0]
"""


def _stretched(calibration: str) -> str:
    records = json.loads(calibration)
    records[0]["Camera"]["ModelViewMatrix"][0][0] *= 1.01
    return json.dumps(records)


WRONG_CALIBRATIONS: dict[str, tuple[Callable[[str], str], list[str]]] = {
    "nan": (lambda good: good.replace('"fx": 260.0', '"fx": NaN', 1), ["camera front", "fx is nan"]),
    "stretched": (_stretched, ["camera front", "its pose is refused", "calibrate it again"]),
    "other_json": (lambda _: '{"cameras": 4}', ["camera record 0", "it lacks SerialNo"]),
    "half": (lambda good: good[: len(good) // 2], ["JSON"]),
    "toml": (lambda _: _TOML, ["camera front", "rotation is [nan, 0.0, 0.0] instead of 3 finite numbers"]),
    "prose": (
        lambda _: "see the notebook of last week",
        ["supported are Assembly101 JSON, AssemblyHands calib.txt, anipose"],
    ),
    "empty": (lambda _: "", ["is empty", "supported are Assembly101 JSON, AssemblyHands calib.txt, anipose"]),
}


@pytest.fixture(scope="module")
def calibration_run(tmp_path_factory: pytest.TempPathFactory) -> tuple[Outcome, dict[str, str]]:
    """Look at one recording with each wrong calibration as a sequence of its own; return the errors by sequence."""
    folder = tmp_path_factory.mktemp("calibrations")
    good = write_recording(folder / "tiny").calibration.read_text()
    lines = ["sequence_id,split,calibration,videos,package"]
    for name, (change, _) in WRONG_CALIBRATIONS.items():
        (folder / f"{name}.calibration").write_text(change(good))
        lines.append(f"{name},test,{name}.calibration,tiny/videos/*.mp4,")
    (folder / "manifest.csv").write_text("\n".join(lines))
    manifest = f"manifest={folder / 'manifest.csv'}"
    outcome = pipeline("executor=serial", manifest, "seq=all", "target=ingest", workspace=folder / "work")
    return outcome, {failure["shard"]: failure["error"] for failure in run_record(folder / "work")["failures"]}


@pytest.mark.parametrize("case", WRONG_CALIBRATIONS)
def test_a_wrong_calibration_is_named_with_reason_and_remedy(
    calibration_run: tuple[Outcome, dict[str, str]], case: str
) -> None:
    outcome, errors = calibration_run
    outcome.assert_refused(1, f"failed: ingest {case}: ")
    assert all(part in errors[case] for part in [f"/{case}.calibration: ", *WRONG_CALIBRATIONS[case][1]]), errors[case]
    assert errors[case].replace("\n", " ") in outcome.said  # brackets and all
