"""Which sequences of a run networks learn from, and which ones figures are about."""

from collections.abc import Mapping
from typing import Final

import pyarrow as pa

TRAINING_SPLITS: Final = ("train", "manual_train")
VALIDATION_SPLITS: Final = ("val", "manual_val")


def judged_sequences(split_of: Mapping[str, str]) -> frozenset[str]:
    """Return the sequences that trained networks are judged by: those of no split for training; all, if all are.

    Args:
        split_of: Sequence → split, of a whole run.
    """
    others = {name for name, split in split_of.items() if split not in (*TRAINING_SPLITS, *VALIDATION_SPLITS)}
    return frozenset(others or split_of)


def judged_of(members: pa.Table) -> list[str]:
    """Return the same of a `catalog.MEMBERS` table, in order."""
    return sorted(
        judged_sequences(dict(zip(*(members[name].to_pylist() for name in ("sequence_id", "split")), strict=True)))
    )
