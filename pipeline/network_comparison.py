"""Egocentric networks and verb classifiers of two runs beside one another, on the same crops and the same segments."""

from collections.abc import Collection, Iterator, Sequence
from typing import Final

import pyarrow as pa
import pyarrow.compute as pc

from assemblyhands_core.data.members import judged_sequences
from assemblyhands_core.data.store import load_table
from assemblyhands_core.metrics.egocentric import by_labels, egocentric_differences
from assemblyhands_core.metrics.run_differences import Difference, shared_rows
from assemblyhands_core.metrics.verbs import verb_differences
from pipeline.config import UserError
from pipeline.difference_tables import Found
from pipeline.ego_evaluation import LABELS, NETWORKS
from pipeline.finished import FinishedRun
from pipeline.manifests import select_rows
from pipeline.verb_evaluation import CLASSIFIERS
from stages.tabulate_verbs import SOURCES

_CROP: Final = ("sequence_id", "frame", "hand", "camera_id", "labels")
_SEGMENT: Final = ("sequence_id", "segment", "first_key", "verb")

Lines = Iterator[tuple[str, Sequence[Difference]]]


def compare_networks(first: FinishedRun, second: FinishedRun) -> dict[str, Found]:
    """Return by title how the networks that both runs have compare, on the sequences that both judged them by."""
    judged = _judged(first) & _judged(second)
    found: dict[str, Found] = {"egocentric hands": dict(_egocentric(first, second, judged))}
    for node, classifier in CLASSIFIERS.items():
        found[f"verbs, {classifier}"] = dict(_verbs(first, second, judged, node))
    return {title: differences for title, differences in found.items() if differences}


def _judged(run: FinishedRun) -> frozenset[str]:
    """Return the sequences that a run's tables are of; those that no manifest knows anymore are among them."""
    try:
        split_of = {row["sequence_id"]: row["split"] for row in select_rows(run.config)}
    except UserError:
        split_of = {}
    return judged_sequences({name: split_of.get(name, "") for name in run.sequences})


def _egocentric(first: FinishedRun, second: FinishedRun, judged: Collection[str]) -> Lines:
    """Yield each network and kind of labels with its differences."""
    for node, network in NETWORKS.items():
        suffix = node.removeprefix("ego_evaluation")
        places = [(f"errors_{labelled}{suffix}", "errors") for labelled in ("manual", "ego")]
        both = _shared(first, second, judged, places, _CROP)
        if both is not None:
            of_second = dict(by_labels(both[1]))
            for labels, errors in by_labels(both[0]):
                resampling = first.ego_settings.resampling
                yield (
                    f"{network}, {LABELS[labels]}",
                    list(egocentric_differences(errors, of_second[labels], resampling)),
                )


def _verbs(first: FinishedRun, second: FinishedRun, judged: Collection[str], node: str) -> Lines:
    """Yield each source of poses with the differences of what a classifier says of them."""
    for source in SOURCES:
        place = node.replace("verb_table", f"verbs_{source}"), "predictions"
        both = _shared(first, second, judged, [place], _SEGMENT)
        if both is not None:
            yield source, list(verb_differences(*both, first.verb_settings.evaluation))


def _shared(
    first: FinishedRun,
    second: FinishedRun,
    judged: Collection[str],
    places: Sequence[tuple[str, str]],
    key: Sequence[str],
) -> tuple[pa.Table, pa.Table] | None:
    """Return the rows of some nodes' tables that both runs have, None without any."""
    found = [_tables(run, judged, places) for run in (first, second)]
    if not all(found):
        return None
    both = shared_rows(pa.concat_tables(found[0]), pa.concat_tables(found[1]), key)
    return both if both[0].num_rows else None


def _tables(run: FinishedRun, judged: Collection[str], places: Sequence[tuple[str, str]]) -> list[pa.Table]:
    folders = [run.folder / node / table for node, table in places]
    is_judged = pc.field("sequence_id").isin(sorted(judged))
    return [load_table(folder).filter(is_judged) for folder in folders if any(folder.glob("*.parquet"))]
