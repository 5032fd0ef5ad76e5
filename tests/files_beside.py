"""Tables that name files by path, as stages get them, and as the store has them: names in the table's own folder."""

from pathlib import Path

import pyarrow as pa

from assemblyhands_core.data.tables import BLOB_SUFFIX


def files_beside(table: pa.Table, folder: Path) -> pa.Table:
    """Link the files that a table names by path into a folder, and name them there."""
    for place, column in enumerate(table.column_names):
        if not column.endswith(BLOB_SUFFIX) or column == "source_file":
            continue
        names = []
        for row, value in enumerate(table[column].to_pylist()):
            path = Path(value)
            names.append(f"{column}-{row}{path.suffix}" if path.is_absolute() else value)
            if path.is_absolute():
                (folder / names[-1]).unlink(missing_ok=True)
                (folder / names[-1]).symlink_to(path)
        table = table.set_column(place, column, pa.array(names, pa.string()))
    return table
