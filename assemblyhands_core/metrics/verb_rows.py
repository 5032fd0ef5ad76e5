"""Predicted verbs of the same segments from several sources of poses, row by row, so that they can be compared."""

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from jaxtyping import Bool, Float, Int, Num

from assemblyhands_core.data.arrays import to_numpy
from assemblyhands_core.data.names import parse_recording_name
from assemblyhands_core.metrics.bootstrap import BlockSums, block_sums

Blocks = Literal["recording", "person"]

_SEGMENT: Final = ("sequence_id", "segment")
_FLOATS: Final = ("confidence", "pose_error_mm", "coverage")


@dataclass(frozen=True, eq=False)
class VerbRows:
    """One source's predictions, a row for each segment, sorted by recording and number.

    Attributes:
        true: Place among the verbs.
        predicted: Likewise, -1 where there is no prediction.
        confidence: In [0, 1].
        pose_error_mm: NaN where unknown.
        coverage: Observed hands, in percent.
        block: Which recording or person a row is of, counted from 0.
        num_blocks: How many there are.
        num_verbs: How many classes there are.
    """

    true: Int[np.ndarray, " row"]
    predicted: Int[np.ndarray, " row"]
    confidence: Float[np.ndarray, " row"]
    pose_error_mm: Float[np.ndarray, " row"]
    coverage: Float[np.ndarray, " row"]
    block: Int[np.ndarray, " row"]
    num_blocks: int
    num_verbs: int

    @property
    def is_right(self) -> Bool[np.ndarray, " row"]:
        """Which verbs were told right; without prediction it is wrong."""
        return np.asarray(self.predicted == self.true)

    @property
    def is_confident(self) -> Bool[np.ndarray, " row"]:
        """Which rows say how sure they are of a prediction."""
        return np.asarray((self.predicted >= 0) & np.isfinite(self.confidence))

    def sums(self, amount: Num[np.ndarray, " row"], counts: Bool[np.ndarray, " row"]) -> BlockSums:
        """Return sums by block of an amount over the rows that count."""
        kept = np.where(counts, amount, 0.0)
        return block_sums(kept[:, None], counts[:, None], self.block, self.num_blocks)

    def accuracies(self) -> BlockSums:
        """Return sums by block of which the means are the verbs' accuracies in percent."""
        is_verb = self.true[:, None] == np.arange(self.num_verbs)
        return block_sums(100.0 * (is_verb & self.is_right[:, None]), is_verb, self.block, self.num_blocks)


def align_sources(
    predictions: pa.Table, verbs: tuple[str, ...], first_source: str, blocks: Blocks
) -> dict[str, VerbRows]:
    """Return each source's rows, of the same segments in the same order.

    Args:
        predictions: As for `metrics.verbs.evaluate_verbs`.
        verbs: The classes.
        first_source: The source that comes first, if there is such a one; the others by name.
        blocks: What goes together.

    Raises:
        ValueError: Sources are not of the same segments, or a verb is none of the classes.
    """
    names = sorted(pc.unique(predictions["source"]).to_pylist(), key=lambda name: (name != first_source, name))
    order = [(column, "ascending") for column in _SEGMENT]
    tables = {name: predictions.filter(pc.equal(predictions["source"], name)).sort_by(order) for name in names}
    for name in names[1:]:
        found, expected = (tables[one].select([*_SEGMENT, "verb"]) for one in (name, names[0]))
        if not found.equals(expected):
            raise ValueError(
                f"{name} has predictions of {found.num_rows} segments, {names[0]} of {expected.num_rows}, and they are "
                "not the same; classify the same segments with the poses of every source."
            )
    return {name: _rows(table, verbs, blocks) for name, table in tables.items()}


def _rows(table: pa.Table, verbs: tuple[str, ...], blocks: Blocks) -> VerbRows:
    names = [_block(name, blocks) for name in table["sequence_id"].to_pylist()]
    _, block = np.unique(np.array(names, dtype=str), return_inverse=True)
    return VerbRows(
        true=_places(table, "verb", {verb: place for place, verb in enumerate(verbs)}),
        predicted=_places(table, "predicted", {verb: place for place, verb in enumerate(verbs)} | {"": -1}),
        **{name: to_numpy(table[name]).astype(np.float64) for name in _FLOATS},
        block=block.ravel(),
        num_blocks=int(block.max(initial=-1)) + 1,
        num_verbs=len(verbs),
    )


def _places(table: pa.Table, column: str, places: dict[str, int]) -> Int[np.ndarray, " row"]:
    values = table[column].to_pylist()
    if odd := sorted(set(values) - places.keys()):
        raise ValueError(
            f"the column {column} has {odd[0]!r}, which is none of the classes {', '.join(filter(None, places))}; "
            "evaluate with the classes that the classifier was trained for."
        )
    return np.array([places[value] for value in values], dtype=np.int64)


def _block(sequence_id: str, blocks: Blocks) -> str:
    """Return what a recording goes together with; those with names of one's own stand for themselves."""
    if blocks == "recording":
        return sequence_id
    try:
        return f"person {parse_recording_name(sequence_id).participant}"
    except ValueError:
        return sequence_id
