"""JSON files from elsewhere: read with suspicion, every refusal one sentence with file, place, reason and remedy."""

import json
import stat
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64

MAX_JSON_BYTES = 4 * 2**30
"""The largest annotation file known (300 K instants of 42 joints) has about 1 GB."""


class FormatError(ValueError):
    """A file does not keep to its format; the message names file, place, reason and remedy."""


class Problems:
    """What is wrong with the entries of a file, gathered to be told together."""

    def __init__(self) -> None:
        self.sentences: list[str] = []

    @contextmanager
    def noted(self) -> Iterator[None]:
        """Note a `FormatError` of one entry and go on with the next."""
        try:
            yield
        except FormatError as error:
            self.sentences.append(str(error))


@contextmanager
def counted_problems() -> Iterator[Problems]:
    """Raise what was noted as one `FormatError`: the first sentence, and how many entries are wrong.

    Raises:
        FormatError: Anything was noted.
    """
    problems = Problems()
    yield problems
    if problems.sentences:
        count = len(problems.sentences)
        raise FormatError(problems.sentences[0] + (f" {count} entries in all are wrong." if count > 1 else ""))


def read_json_object(path: Path, max_bytes: int = MAX_JSON_BYTES) -> dict[str, Any]:
    """Read a file that holds one JSON object.

    Raises:
        FormatError: The file is missing, too large, no JSON, no object, or a key in it occurs twice.
    """
    data = read_bytes(path, max_bytes)
    try:
        document = json.loads(data, object_pairs_hook=_object_without_doubles)
    except RecursionError as error:
        raise FormatError(f"{path}: its JSON is nested without end; get the file again.") from error
    except ValueError as error:  # also of doubles, of bytes that are no text, and of numbers with thousands of digits
        raise FormatError(
            f"{path}: this is no such JSON ({str(error).removesuffix('.')}); get the file again."
        ) from error
    return json_object(document, str(path))


def read_bytes(path: Path, max_bytes: int) -> bytes:
    """Read a file unless it is larger than anything of its kind, whatever it says of its size.

    Raises:
        FormatError: The file is missing, no regular file, not readable or too large.
    """
    try:
        facts = path.stat()
        if not stat.S_ISREG(facts.st_mode):  # a device may have no end, a pipe no beginning
            raise FormatError(f"{path}: is no regular file; check the path.")
        if (size := facts.st_size) > max_bytes:
            raise FormatError(f"{path}: has {size} bytes, more than the {max_bytes} that such a file may have.")
        with path.open("rb") as file:
            data = file.read(size + 1)
    except OSError as error:
        raise FormatError(f"{path}: cannot be read ({error.strerror}); check the path.") from error
    if len(data) > size:
        raise FormatError(f"{path}: has more bytes than its size of {size}; wait until it is written.")
    return data


def write_json(path: Path, document: Mapping[str, Any] | Sequence[Any]) -> None:
    """Write a document on one line; the same document gives the same bytes, and numbers are read back exactly.

    Raises:
        ValueError: It holds NaN or infinity, which JSON has not.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(document, allow_nan=False, separators=(",", ":")) + "\n", encoding="utf-8")


def json_object(value: object, where: str) -> dict[str, Any]:
    """Return a value that has to be a JSON object."""
    if not isinstance(value, dict):
        raise FormatError(f"{where}: expected a JSON object, got {kind_of(value)}; get the file again.")
    return value


def json_list(value: object, where: str, max_length: int = 10**8) -> list[Any]:
    """Return a value that has to be a JSON list."""
    if not isinstance(value, list) or len(value) > max_length:
        raise FormatError(f"{where}: expected a JSON list, got {kind_of(value)}; get the file again.")
    return value


def member(block: Mapping[str, Any], key: str, where: str) -> Any:
    """Return what a JSON object has under a key that it must have."""
    if key not in block:
        raise FormatError(f"{where}: lacks {key!r}; get the file again.")
    return block[key]


def whole_number(value: object, where: str, low: int = 0, high: int = 2**53) -> int:
    """Return a value that has to be a whole number within bounds."""
    if type(value) is not int or not low <= value <= high:
        raise FormatError(f"{where}: expected a whole number from {low} to {high}, got {kind_of(value)}; correct it.")
    return value


def numbers(value: object, shape: tuple[int, ...], where: str, is_finite: bool = True) -> Float64[np.ndarray, "..."]:
    """Return nested lists of numbers as an array; lengths and types are looked at before room is made for it.

    Raises:
        FormatError: Another shape or type, a number too large, or (unless `is_finite` is False) NaN or infinity.
    """
    if not _is_nested(value, shape):
        raise FormatError(f"{where}: expected {'x'.join(map(str, shape))} numbers, got {kind_of(value)}; correct it.")
    try:
        array = np.array(value, dtype=np.float64)
    except OverflowError as error:
        raise FormatError(f"{where}: holds a number that no measurement has; correct it.") from error
    if is_finite and not np.isfinite(array).all():
        raise FormatError(f"{where}: holds NaN or infinity; correct it or leave the entry out.")
    return array


def kind_of(value: object) -> str:
    """Describe a JSON value in a few words."""
    if isinstance(value, dict | list):
        name = "an object" if isinstance(value, dict) else "a list"
        return f"{name} of {len(value)}"
    text = repr(value)
    return text if len(text) <= 40 else f"{text[:37]}..."


def _is_nested(value: object, shape: tuple[int, ...]) -> bool:
    if not shape:
        return type(value) in (int, float)
    return isinstance(value, list) and len(value) == shape[0] and all(_is_nested(part, shape[1:]) for part in value)


def _object_without_doubles(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    block: dict[str, Any] = {}
    for key, value in pairs:
        if key in block:
            raise ValueError(f"the key {kind_of(key)} occurs twice in one object")
        block[key] = value
    return block
