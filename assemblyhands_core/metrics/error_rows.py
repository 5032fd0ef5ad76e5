"""Errors of several methods at the same hands and instants, row by row, so that they can be compared in pairs."""

import re
from dataclasses import dataclass

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from jaxtyping import Bool, Float, Int, Shaped

from assemblyhands_core.data.arrays import to_numpy

_ROUND = re.compile(r"R\d+")
_KEY = ("sequence_id", "frame", "hand")


@dataclass(frozen=True, eq=False)
class ErrorRows:
    """One method's errors, a row for each hand at each instant, sorted by sequence, frame and hand.

    Attributes:
        error_mm: NaN where a joint is missing.
        wrist_relative_error_mm: Likewise, after the hands' wrists were put onto each other.
        is_labelled: Where the truth is known.
        is_own: Whether the method found the hand itself, instead of keeping what another one found.
        block: Which stretch of which sequence a row belongs to, counted from 0.
        num_blocks: How many there are.
    """

    sequence_id: Shaped[np.ndarray, " row"]
    frame: Int[np.ndarray, " row"]
    hand: Shaped[np.ndarray, " row"]
    verb: Shaped[np.ndarray, " row"]
    occlusion_rate: Float[np.ndarray, " row"]
    error_mm: Float[np.ndarray, "row joint=21"]
    wrist_relative_error_mm: Float[np.ndarray, "row joint=21"]
    is_labelled: Bool[np.ndarray, "row joint=21"]
    is_own: Bool[np.ndarray, " row"]
    block: Int[np.ndarray, " row"]
    num_blocks: int


def align_methods(errors: pa.Table, block_frames: int) -> dict[str, ErrorRows]:
    """Return each method's rows, the same ones in the same order; the paper's order of methods, rounds last.

    Args:
        errors: Rows of the table `ERRORS`.
        block_frames: Length of the stretches that bootstrap draws whole.

    Raises:
        ValueError: A method lacks rows that another has, so that their means would be over different instants.
    """
    names = sorted(pc.unique(errors["method"]).to_pylist(), key=lambda name: (bool(_ROUND.fullmatch(name)), name))
    found = {name: _rows(errors.filter(pc.equal(errors["method"], name)), block_frames) for name in names}
    for name in names[1:]:
        first, other = found[names[0]], found[name]
        if not all(np.array_equal(getattr(first, column), getattr(other, column)) for column in _KEY):
            raise ValueError(
                f"method {name} has errors at {len(other.frame)} hands, {names[0]} at {len(first.frame)}, and they are "
                "not the same; evaluate both on the same sequences."
            )
    return found


def _rows(table: pa.Table, block_frames: int) -> ErrorRows:
    table = table.sort_by([(name, "ascending") for name in _KEY])
    sequence, frame = to_numpy(table["sequence_id"]), to_numpy(table["frame"])
    _, number = np.unique(sequence.astype(str), return_inverse=True)
    _, block = np.unique(np.stack([number, frame // block_frames], axis=1), axis=0, return_inverse=True)
    columns = {name: to_numpy(table[name]) for name in ("hand", "verb", "is_labelled", "is_own")}
    floats = ("occlusion_rate", "error_mm", "wrist_relative_error_mm")
    return ErrorRows(
        sequence_id=sequence,
        frame=frame,
        **columns,
        **{name: to_numpy(table[name]).astype(np.float64) for name in floats},
        block=block.ravel(),
        num_blocks=int(block.max(initial=-1)) + 1,
    )
