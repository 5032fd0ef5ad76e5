"""What a run says about verbs: accuracy by source of poses, beside how good these poses are (paper, Table 5).

And what is wrong with the labels that the accuracy is of.
"""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import pyarrow.parquet as pq
from rich.console import Console

from assemblyhands_core.data.verb_segments import Drop, Note
from assemblyhands_core.metrics.verbs import TABLE
from pipeline.grids import Grid, rich_table
from pipeline.set_tables import figure_with_interval, labelled_rows, write_rows
from pipeline.terminal import say
from stages.cut_verb_clips import NO_POSES

CLASSIFIERS: Final = {
    "verb_table": "shipped network, our annotation",
    "verb_table_manual": "shipped network, people's labels",
    "own_verb_table": "trained on each source, our annotation",
    "own_verb_table_manual": "trained on each source, people's labels",
}
"""Node → what readers call the classifier that it judges, and whose labels its poses come from."""
_COLUMNS: Final = {
    "mean_verb_accuracy": "mean over verbs (%)",
    "accuracy": "over segments (%)",
    "relative_mean_verb_accuracy": "of the upper bound (%)",
    "pose_error_mm": "pose error (mm)",
    "pose_coverage": "observed, of 30 Hz (%)",
}
_SEGMENT_NODES: Final = ("clips_annotation", "clips_annotation_manual")
"""Whose segments are counted; those of other poses are the same ones."""
_KEPT: Final = frozenset({*Note, NO_POSES})
_MAX_SAID: Final = 10  # sentences on the terminal; the page has all


@dataclass(frozen=True)
class OddLabels:
    """What is wrong with the action labels of a run's recordings.

    Attributes:
        counts: A line for each node that cut segments: how many were left out or are odd, by reason.
        sentences: About each row or segment, once.
    """

    counts: Sequence[str]
    sentences: Sequence[str]


def print_verbs(console: Console, run: Path) -> None:
    """Print a table for each kind of labels, and write all figures to `report/verbs.csv`; nothing without any.

    Before it, what is wrong with these labels.
    """
    odd = odd_labels(run)
    for line in (*odd.counts, *(f"  {sentence}" for sentence in odd.sentences[:_MAX_SAID])):
        say(console, line)
    if num_more := len(odd.sentences[_MAX_SAID:]):
        say(console, f"  {num_more} more of them: the column sentence of {run / _SEGMENT_NODES[0]}*/problems/*.parquet")
    rows = verb_rows(run)
    for name in dict.fromkeys(row["classifier"] for row in rows):
        console.print(rich_table(verb_grid(name, [row for row in rows if row["classifier"] == name])))
    if rows:
        write_rows(run / "report" / "verbs.csv", rows)


def odd_labels(run: Path) -> OddLabels:
    """Return what is wrong with the labels of a run; nothing where all of them were read and used."""
    counts: list[str] = []
    sentences: dict[str, None] = {}
    for node in _SEGMENT_NODES:
        tables = [
            pq.read_table(path.resolve()).to_pylist() for path in sorted((run / node / "problems").glob("*.parquet"))
        ]
        rows = [row for table in tables for row in table]
        # Each recording has all unreadable rows of a shared file; sentences about segments begin with the recording.
        of_files = {s: None for row in rows if (s := row["sentence"]) and not s.startswith(f"{row['sequence_id']}: ")}
        sentences |= of_files | {row["sentence"]: None for row in rows if row["sentence"]}
        counts += _counted(node, rows, len(of_files))
    return OddLabels(counts, list(sentences))


def _counted(node: str, rows: Sequence[Mapping[str, Any]], num_unreadable: int) -> Iterator[str]:
    """Yield how many segments were left out or are odd; that a file has other recordings, too, is nothing odd."""
    by_reason = Counter({str(Drop.UNREADABLE): num_unreadable})
    for row in rows:
        if row["reason"] not in ("", Drop.UNREADABLE, Drop.OTHER_RECORDING):
            by_reason[row["reason"]] += row["count"]
    parts = []
    for what, is_kept in (("left out", False), ("kept, though odd", True)):
        own = [
            f"{reason.replace('_', ' ')} {n}" for reason, n in by_reason.items() if n and (reason in _KEPT) is is_kept
        ]
        parts += [f"{what}: {', '.join(own)}"] if own else []
    if parts:
        yield f"action labels, {node}: {'; '.join(parts)}"


def verb_rows(run: Path) -> list[dict[str, Any]]:
    """Return all figures about verbs, with the `classifier` that each is of."""
    return list(labelled_rows(run, CLASSIFIERS, "classifier"))


def verb_grid(name: str, rows: Sequence[Mapping[str, Any]]) -> Grid:
    """Return a line for each source of poses, and for chance, of one classifier's figures."""
    found = {(row["table"], row["group"], row["row"], row["metric"]): row for row in rows}
    verbs = list(dict.fromkeys(row["group"] for row in rows if row["table"] == f"{TABLE}_by_verb"))
    lines = []
    for source in dict.fromkeys(row["row"] for row in rows if row["table"] == TABLE):
        by_verb = [found.get((f"{TABLE}_by_verb", verb, source, "accuracy")) for verb in verbs]
        overall = [found.get((TABLE, "", source, metric)) for metric in _COLUMNS]
        values = [*(_plain(row) for row in by_verb), *(figure_with_interval(row, 1) for row in overall)]
        lines.append([source, *values, str(found[TABLE, "", source, "accuracy"]["n"])])
    return Grid(f"verbs, {name} (95 % intervals)", ["poses", *verbs, *_COLUMNS.values(), "n"], lines)


def _plain(row: Mapping[str, Any] | None) -> str:
    return "–" if row is None or row["value"] != row["value"] else f"{row['value']:.0f}"
