"""The tables of one sequence in the folder of a run."""

import fnmatch
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import pyarrow as pa
import pyarrow.compute as pc

from assemblyhands_core.data.store import load_table
from assemblyhands_core.data.tables import TableSpec
from pipeline.config import UserError
from pipeline.manifests import listed, name_patterns

_SHARD: Final = re.compile(r"(?P<sequence>.+?)(\.\d{5})?\.parquet")


@dataclass(frozen=True)
class SequenceTables:
    """What a run knows of a sequence.

    Attributes:
        run: Its folder.
        sequence_id: The sequence.
    """

    run: Path
    sequence_id: str

    def nodes_with(self, table: str) -> list[str]:
        """Return the nodes that have rows of this table about the sequence, by name."""
        folders = sorted(self.run.glob(f"*/{table}"))
        return [folder.parent.name for folder in folders if self._files(folder.parent.name, table)]

    def read(self, node: str, table: str, spec: TableSpec) -> pa.Table:
        """Return a node's table, without rows where the run has none.

        Raises:
            OSError: naming a file that is damaged or gone.
        """
        found = [load_table(file) for file in self._files(node, table)]
        return pa.concat_tables([spec.empty(), *found])

    def _files(self, node: str, table: str) -> list[Path]:
        files = sorted((self.run / node / table).glob("*.parquet"))
        return [file for file in files if sequence_of(file) == self.sequence_id]


def chosen_sequences(wanted: str, there: Sequence[str], run: str, needed: str) -> list[str]:
    """Return the sequences of a run that ``seq`` names.

    Args:
        wanted: Names and globs with commas between them, or all; a leading - leaves out.
        there: The sequences that have what is needed.
        run: The run's name, for the message.
        needed: What is needed of a sequence, for the message.

    Raises:
        UserError: It names none of them.
    """
    asked, left_out = (
        {name for pattern in patterns for name in fnmatch.filter(there, pattern)} for patterns in name_patterns(wanted)
    )
    chosen = [name for name in there if name in asked - left_out]
    if not chosen:
        raise UserError(f"run {run} has no {needed} of sequence {wanted}; seq= is one of {listed(there)}")
    return chosen


def sequence_of(file: Path) -> str:
    """Return the sequence that a table's file in a run's folder is about."""
    match = _SHARD.fullmatch(file.name)
    return match["sequence"] if match else file.stem


def between(table: pa.Table, first_frame: int, end_frame: int) -> pa.Table:
    """Return the rows of frames from a first one to before an end."""
    return table.filter((pc.field("frame") >= first_frame) & (pc.field("frame") < end_frame))
