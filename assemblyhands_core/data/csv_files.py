"""CSV files from elsewhere: held to a size, and one sentence for whatever is no CSV."""

import csv
import io
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from assemblyhands_core.data.json_files import FormatError, read_bytes


@contextmanager
def opened_csv(path: Path, max_bytes: int, **dialect: Any) -> Iterator["csv.DictReader[str]"]:
    """Give the reader of a file's rows, which come one by one: rows of many columns take far more room than the file.

    Args:
        path: UTF-8, with or without a mark at its beginning.
        max_bytes: More is no such file.
        dialect: As `csv.DictReader` takes it.

    Raises:
        FormatError: The file is missing, too large, no text or, found while rows are read, no CSV.
    """
    try:
        text = read_bytes(path, max_bytes).decode("utf-8-sig")
        yield csv.DictReader(io.StringIO(text, newline=""), **dialect)
    except (UnicodeDecodeError, csv.Error) as error:
        raise FormatError(f"{path}: cannot be read as CSV ({error}); save it as comma-separated UTF-8.") from error
