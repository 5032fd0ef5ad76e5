"""``python -m pipeline view``: a run's sequences as files for the viewer rerun, ``work/runs/<run>/view/<seq>.rrd``."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from rich.console import Console

from assemblyhands_core.data.layout import DatasetLayout
from assemblyhands_core.data.video import VideoError
from assemblyhands_core.viz.rerun_file import NoRerun
from pipeline.config import RunConfig, UserError
from pipeline.finished import open_run
from pipeline.manifests import select_rows
from pipeline.rerun_scene import write_scene
from pipeline.sequence_tables import SequenceTables, chosen_sequences, sequence_of
from pipeline.takes import STUDIO_PACKAGE, studio_folder
from pipeline.terminal import say

_FOLDER: Final = "view"
_CAMERA_NODES: Final = ("ingest", "ingest_ego")


def write_rerun_views(config: RunConfig, console: Console) -> int:
    """Write a file for rerun for each sequence that ``seq`` names in a run; return the exit code.

    Raises:
        UserError: There is no such run or sequence, a video is gone or damaged, or rerun is not installed.
    """
    run = open_run(config, config.run).folder
    for sequence_id in chosen_sequences(config.seq, _sequences_with_cameras(run), run.name, "cameras"):
        path = run / _FOLDER / f"{sequence_id}.rrd"
        truth = ground_truth_folder(config, run, sequence_id, console)
        try:
            said = write_scene(path, SequenceTables(run, sequence_id), config.view, _min_confidence(config), truth)
        except NoRerun as error:
            raise UserError(str(error)) from error
        except VideoError as error:
            remedy = "put the video back where the run had it, or write the file without pictures: view.pictures=false"
            raise UserError(f"{sequence_id}: {error}; {remedy}") from error
        _say(console, said, path)
    return 0


def _say(console: Console, said: str, path: Path) -> None:
    megabytes = path.stat().st_size / 1e6
    for sentence in (said, f"rerun: {path} ({megabytes:.1f} MB); open it: .venv/bin/rerun {path}"):
        say(console, sentence)


def _min_confidence(config: RunConfig) -> float:
    """Return below which confidence triangulation takes no notice of a keypoint."""
    return float(config.stages["triangulate"].model_dump()["min_confidence"])


def _sequences_with_cameras(run: Path) -> list[str]:
    return sorted({sequence_of(file) for node in _CAMERA_NODES for file in run.glob(f"{node}/views/*.parquet")})


def ground_truth_folder(config: RunConfig, run: Path, sequence_id: str, console: Console) -> Path | None:
    """Return the folder of a sequence's truth, None without any.

    Args:
        config: Its manifest counts, else the one that the run was made with.
        run: The run's folder.
        sequence_id: The sequence.
        console: Where it is said if the manifest is gone.
    """
    recorded: Mapping[str, Any] = json.loads((run / "run.json").read_text(encoding="utf-8"))["config"]
    if recorded.get("rig", {}).get("calibration"):
        return None
    update = {"seq": sequence_id, "manifest": config.manifest or recorded["manifest"]}
    try:
        (row,) = select_rows(config.model_copy(update=update))
    except UserError as error:
        say(console, f"without truth: {error}")
        return None
    if row["package"] == STUDIO_PACKAGE:
        folder = DatasetLayout(studio_folder(config.workspace)).ground_truth(sequence_id)
        return folder if folder.is_dir() else None
    return Path(row["folder"], row["ground_truth"]) if row["ground_truth"] else None
