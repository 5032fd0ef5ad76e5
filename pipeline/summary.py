"""What a run says at its end, and what ``plan`` and ``doctor`` print."""

import itertools
import json
import time
from collections import defaultdict
from collections.abc import Collection, Sequence
from pathlib import Path

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from pipeline.config import RunConfig
from pipeline.grids import Grid, rich_table
from pipeline.plan import PlannedNode
from pipeline.tasks import Result
from pipeline.terminal import say
from pipeline.view import node_digest
from stages.annotate_round import SHIPPED_WEIGHTS, weights_path

_ON_SHIPPED_WEIGHTS = (
    "MVExoNet's shipped weights have seen synthetic hands alone; on real ones the table 'agreement with 2D + "
    "triangulation' says how far to trust its rounds"
)
_LEVEL_STYLES = {"ok": "green", "warning": "yellow", "error": "red"}


def print_plan(console: Console, rows: Sequence[PlannedNode], seconds: float | None) -> None:
    """Print what runs, what is reused, and why."""
    table = Table("sequence", "node", "reuse", "run", "why", "estimate", title="plan", title_justify="left")
    for row in rows:
        to_run = "?" if row.num_to_run is None else str(row.num_to_run)
        estimate = "" if row.seconds is None or row.num_to_run == 0 else _duration(row.seconds)
        table.add_row(row.sequence_id, row.node, str(row.num_reused), to_run, escape(row.reason), estimate)
    console.print(table)
    if all(row.num_to_run == 0 for row in rows):
        say(console, "nothing to do: everything is reused")
    elif seconds is not None:
        say(console, f"estimated time: {_duration(seconds)}")


def print_failures(console: Console, results: Sequence[Result], logs: Path) -> None:
    """Print a table of what failed, and what could not run because of it."""
    table = Table("node", "shard", "status", "reason", title="not finished", title_justify="left")
    for result in (r for r in results if not r.has_entry):
        table.add_row(result.node, str(result.shard), result.status, escape(result.error))
    console.print(table)
    advice = "Run the same command again after the remedy."
    say(console, f"everything else is done and kept; logs: {logs}. {advice}")


def print_times(console: Console, results: Sequence[Result], started: float) -> None:
    """Print shards, time and content digest of each node."""
    table = Table("node", "shards", "reused", "work", "content digest", title="time by node", title_justify="left")
    by_node: dict[str, list[Result]] = defaultdict(list)
    for result in results:
        by_node[result.node].append(result)
    for node, shards in by_node.items():
        reused = sum(result.status == "reused" for result in shards)
        seconds = sum(result.seconds for result in shards if result.status == "done")
        digest = node_digest(results, node)[:16]
        table.add_row(node, str(len(shards)), str(reused), _duration(seconds) if seconds else "", digest)
    console.print(table)
    say(console, f"engine time: {time.monotonic() - started:.1f} s")


def print_unmade(console: Console, config: RunConfig, found: Sequence[Result]) -> None:
    """Say what of a target is about all sequences and was not made, because none of them has what it needs."""
    made = {result.node for result in found}
    unmade = [name for name in config.wanted_nodes if config.dag.nodes[name].shard == "set" and name not in made]
    if unmade:
        say(console, f"not made, as no sequence of this run has what they need: {', '.join(unmade)}")


def print_left_out(console: Console, run: Path) -> None:
    """Print which views were not used, by reason; ``doctor`` has said it already."""
    if (run / "audit").is_dir():
        return
    for path in sorted((run / "ingest" / "views").glob("*.parquet")):
        by_reason: dict[str, list[str]] = defaultdict(list)
        for row in pq.read_table(path.resolve()).to_pylist():
            by_reason[row["reason"]].append(row["camera_id"])
        by_reason.pop("", None)
        parts = [f"{', '.join(cameras)} ({reason})" for reason, cameras in by_reason.items()]
        if parts:
            say(console, f"{path.stem}: views left out: {'; '.join(parts)}; `doctor` says more")


def print_quality(console: Console, run: Path) -> None:
    """Print the tables that the node ``quality`` made."""
    for grid in quality_grids(run):
        console.print(rich_table(grid))
    for path in sorted((run / "detect_hands" / "followed").glob("*.parquet")):
        for note in pq.read_table(path.resolve()).column("note").to_pylist():
            say(console, f"{path.stem}: {note}")
    for picture in itertools.chain(*drawn_pictures(run).values()):
        say(console, f"picture: {picture}")


def quality_grids(run: Path) -> list[Grid]:
    """Return the tables that the node ``quality`` made of each sequence; titles are the sequences."""
    grids = []
    for path in sorted((run / "quality" / "quality").glob("*.parquet")):
        frame = pq.read_table(path.resolve()).to_pandas()
        for name, rows in frame.groupby("table", sort=False):
            wide = rows.pivot_table(index="row", columns="metric", values="value", sort=False, dropna=False)
            lines = [[str(row), *("" if x != x else f"{x:.4g}" for x in values)] for row, values in wide.iterrows()]
            grids.append(Grid(path.stem, [str(name), *map(str, wide.columns)], lines))
    return grids


def drawn_pictures(run: Path) -> dict[str, list[Path]]:
    """Return the pictures and films that each of a run's nodes drew."""
    drawn: dict[str, list[Path]] = defaultdict(list)
    for link in sorted(run.glob("*/overlays/*.parquet")):
        table = link.resolve()
        names = pq.read_table(table).column("overlay_file").to_pylist()
        drawn[link.parents[1].name] += [table.parent / name for name in names]
    return {node: paths for node, paths in drawn.items() if paths}


def print_rounds(console: Console, run: Path, synthetic: Collection[str]) -> None:
    """Print how the hands of each sequence came by their joints in each round, and of real ones what weights know."""
    strangers = []
    for path in sorted(run.glob("round_[1-9]/manifest.json")):
        for name, config in json.loads(path.read_text())["configs"].items():
            files = sorted((path.parent / "rounds").glob(f"{name}.*"))
            rounds = pa.concat_tables([pq.read_table(file.resolve()) for file in files]).to_pandas()
            say(console, f"{name}, {path.parent.name}: {_of_round(rounds)}")
            is_shipped = weights_path(config["weights"]) == weights_path(SHIPPED_WEIGHTS)
            strangers += [name] if is_shipped and name not in synthetic else []
    for name in dict.fromkeys(strangers):
        say(console, f"{name}: {_ON_SHIPPED_WEIGHTS}")


def _of_round(rounds: pd.DataFrame) -> str:
    """Return a round's hands in words: how many have a new estimate, and why the others have none."""
    counts = rounds["reason"].replace("", "estimated").value_counts()
    shares = ", ".join(f"{reason} {100 * count / len(rounds):.1f} %" for reason, count in counts.items())
    moved_mm = rounds["displacement_mm"][rounds["reason"] == ""].median()
    return f"{len(rounds)} hands, {shares}; new estimates moved by {moved_mm:.1f} mm in the median"


def print_weights(console: Console, run: Path) -> None:
    """Print where trainings left their weights, and which had nothing to learn from."""
    untrained = []
    for path in sorted(run.glob("*/weights/*.parquet")):
        rows = pq.read_table(path.resolve()).to_pylist()
        untrained += [] if rows else [path.parts[-3]]
        for row in rows:
            say(console, f"weights: {row['network']} in {path.resolve().parent / row['weights_file']}")
    if untrained:
        needed = "no sequence of split train, or manual_train with people's labels, has what they learn from"
        say(console, f"not trained, as {needed}: {', '.join(untrained)}")


def print_keypoints(console: Console, run: Path) -> None:
    """Print for which sequences no detector ran."""
    for path in sorted((run / "detect_keypoints").glob("manifest.json")):
        for name, config in json.loads(path.read_text())["configs"].items():
            root = config.get("options", {}).get("precomputed", {}).get("root")
            if root is not None:
                say(console, f"{name}: no detector ran, its 2D keypoints were given: {root}")


def print_corrections(console: Console, run: Path) -> None:
    """Print in which sequences people set points by hand."""
    files = [path.resolve() for path in sorted((run / "corrections" / "corrections").glob("*.parquet"))]
    if not files:
        return
    points = pa.concat_tables([pq.read_table(file) for file in files]).to_pandas()
    for name, of_sequence in points.groupby("sequence_id"):
        hands = len(of_sequence[["frame", "hand"]].drop_duplicates())
        say(console, f"{name}: {len(of_sequence)} points of {hands} hands were corrected by hand")


def print_audit(console: Console, run: Path) -> None:
    """Print what ``doctor`` found in each recording."""
    for path in sorted((run / "audit" / "audit").glob("*.parquet")):
        table = Table("check", "camera", "level", "finding", title=path.stem, title_justify="left")
        for row in pq.read_table(path.resolve()).to_pylist():
            style = _LEVEL_STYLES[row["level"]]
            table.add_row(row["check"], row["camera_id"], f"[{style}]{row['level']}[/]", escape(row["note"]))
        console.print(table)


def _duration(seconds: float) -> str:
    minutes, rest = divmod(seconds, 60)
    hours, minutes = divmod(int(minutes), 60)
    return f"{hours} h {minutes} min" if hours else f"{minutes} min {rest:.0f} s" if minutes else f"{rest:.1f} s"
