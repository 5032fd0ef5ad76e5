"""What the rounds did: how far their joints are from the 2D keypoints of each camera, and how far hands moved."""

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd
import pyarrow.parquet as pq

from assemblyhands_core.data.arrays import evenly_spread
from assemblyhands_core.data.camera_rows import valid_cameras
from assemblyhands_core.data.keypoint_rows import distances_px, keypoints_by_view, positions, rows_of_hands
from assemblyhands_core.data.rounds import joints_or_nan
from assemblyhands_core.hands.joints import JOINT_NAMES
from pipeline.finished import FinishedRun
from pipeline.grids import Grid
from pipeline.html_report.page import Block, Fold, Table, Text
from pipeline.measured import NothingToShow
from pipeline.round_crops import round_label, round_nodes

MAX_SHARDS: Final = 64
"""Of a run are looked at for reprojection, evenly spread: its joints are projected anew."""
_DECIMALS: Final = 2

Distances = Mapping[tuple[str, str], np.ndarray]
"""Round and camera → (hand, joint) distances in px, NaN where either side is unknown."""


def reprojection(run: FinishedRun) -> Iterator[Block]:
    """Yield the median distance from projected joints to 2D keypoints by camera, joint and round."""
    files = _whole_shards(run.folder)
    if not files:
        raise NothingToShow("this run has no joints beside 2D keypoints.")
    looked_at = [files[index] for index in evenly_spread(len(files), MAX_SHARDS)]
    found = _distances(run, looked_at)
    rounds, cameras = (list(dict.fromkeys(key[place] for key in found)) for place in (0, 1))
    yield Text(
        "Median distance (px of the camera's own video) from the projected joint to its 2D keypoint, over those "
        f"keypoints that took part; {len(looked_at)} of {len(files)} chunks, evenly spread."
    )
    rows = [_camera_row(camera, [found.get((name, camera)) for name in rounds]) for camera in sorted(cameras)]
    overall = Grid("Median reprojection by camera and round (px)", ["camera", *rounds, "n, most"], rows)
    yield Table(overall, shaded=range(1, len(rounds) + 1))
    for name in rounds:
        grid = _joint_grid(name, found)
        yield Fold(f"By camera and joint: {name}", [Table(grid, shaded=range(1, len(grid.columns)))])


def displacement(run: FinishedRun) -> Iterator[Block]:
    """Yield how far hands moved from each round to the next, and why some kept the joints they had."""
    rows, kept = [], []
    for node in round_nodes(run.folder)[1:]:
        files = sorted((node / "rounds").glob("*.parquet"))
        columns = ["displacement_mm", "reason"]
        if not files:
            continue
        rounds = pd.concat([pq.read_table(file.resolve(), columns=columns).to_pandas() for file in files])
        is_new = rounds["reason"] == ""
        moved_mm = rounds.loc[is_new, "displacement_mm"].dropna()
        number = int(node.name.removeprefix("round_"))
        quantiles = [f"{moved_mm.quantile(share):.2f}" if len(moved_mm) else "–" for share in (0.5, 0.9, 0.99, 1.0)]
        new = [f"{100 * is_new.mean():.2f}" if len(rounds) else "–", str(len(rounds))]
        rows.append([f"R{number - 1} → R{number}", *new, *quantiles])
        kept += [[f"R{number}", str(reason).replace("_", " "), str(count), f"{100 * count / len(rounds):.2f}"]
                 for reason, count in rounds.loc[~is_new, "reason"].value_counts().items()]  # fmt: skip
    if not rows:
        raise NothingToShow("this run has no rounds after 2D + triangulation.")
    columns = ["step", "new estimate (%)", "hands", "moved: median (mm)", "90 % within", "99 % within", "largest"]
    note = "A hand's movement is the mean over its joints; R0 is 2D + triangulation."
    yield Table(Grid("How far hands moved", columns, rows), note=note)
    if kept:
        yield Table(Grid("Hands without a new estimate", ["round", "reason", "hands", "share (%)"], kept))


def _whole_shards(run: Path) -> list[str]:
    """Return the names of the files that every round and the keypoints have."""
    tables = [*(node / "joints" for node in round_nodes(run)), run / "detect_keypoints" / "keypoints"]
    if len(tables) < 2:
        return []
    names = set.intersection(*({path.name for path in table.glob("*.parquet")} for table in tables))
    return sorted(name for name in names if (run / "ingest" / "views" / _views_file(name)).exists())


def _views_file(shard: str) -> str:
    return f"{shard.rsplit('.', 2)[0]}.parquet"


def _distances(run: FinishedRun, files: list[str]) -> Distances:
    parts: dict[tuple[str, str], list[np.ndarray]] = defaultdict(list)
    for file in files:
        views = pq.read_table((run.folder / "ingest" / "views" / _views_file(file)).resolve())
        cameras = valid_cameras(views)
        keypoints = pq.read_table((run.folder / "detect_keypoints" / "keypoints" / file).resolve())
        for node in round_nodes(run.folder):
            joints = pq.read_table((node / "joints" / file).resolve())
            place = rows_of_hands(keypoints, joints), positions(keypoints["camera_id"], list(cameras))
            least = run.round_settings.min_keypoint_confidence
            pixels, _ = keypoints_by_view(keypoints, *place, joints.num_rows, len(cameras), least)
            apart_px = distances_px(joints_or_nan(joints), list(cameras.values()), pixels)
            for view, camera in enumerate(cameras):
                parts[round_label(node), camera].append(apart_px[:, view].astype(np.float32))
    return {key: np.concatenate(of_key) for key, of_key in parts.items()}


def _camera_row(camera: str, by_round: Sequence[np.ndarray | None]) -> list[str]:
    return [camera, *map(_median, by_round), str(max(map(_num_known, by_round)))]


def _joint_grid(round_name: str, found: Distances) -> Grid:
    cameras = sorted(camera for name, camera in found if name == round_name)
    rows = [
        [joint_name, *(_median(found[round_name, camera][:, joint]) for camera in cameras)]
        for joint, joint_name in enumerate(JOINT_NAMES)
    ]
    return Grid(f"Median reprojection by joint and camera, {round_name} (px)", ["joint", *cameras], rows)


def _median(values: np.ndarray | None) -> str:
    known = np.empty(0) if values is None else values[np.isfinite(values)]
    return f"{np.median(known):.{_DECIMALS}f}" if known.size else "–"


def _num_known(values: np.ndarray | None) -> int:
    return 0 if values is None else int(np.isfinite(values).sum())
