"""The rows of the manifests that a run is about."""

import fnmatch
import glob
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Final

from assemblyhands_core.data.csv_files import opened_csv
from assemblyhands_core.data.json_files import FormatError
from assemblyhands_core.data.names import is_file_part
from pipeline.config import RunConfig, UserError

MANIFESTS: Final = Path(__file__).resolve().parents[1] / "data_manifests"

_DEFAULTS: Final = ("demo.csv", "synthetic_tiny.csv")
_COLUMNS: Final = ("sequence_id", "split", "calibration", "videos", "package")
_OPTIONAL: Final = (
    "keypoints", "ground_truth", "labels", "actions", "ego_calibration", "ego_videos", "corrections",
    "rig", "duration_s", "rate_hz",
)  # fmt: skip
ALL: Final = "all"
"""What ``seq`` calls all sequences."""
_MAX_LISTED: Final = 10
_MAX_BYTES: Final = 2**23
_FORBIDDEN_IN_NAMES: Final = set("*?[],= ")

ManifestRow = Mapping[str, str]
"""A row's columns, empty where it says nothing; ``manifest``, its file, and ``folder``, that of the manifest."""


def select_rows(config: RunConfig) -> list[ManifestRow]:
    """Return the rows that ``seq`` names, in its order.

    Raises:
        UserError: there is no such manifest or sequence, or a manifest is not as it should be.
    """
    rows = _manifest_rows(config.manifest)
    return [rows[name] for name in _selected(config.seq, list(rows))]


def checked_name(name: str) -> str:
    """Return a sequence's name if it can be part of file names.

    Raises:
        UserError: it cannot.
    """
    if not is_file_part(name) or _FORBIDDEN_IN_NAMES & set(name):
        raise UserError(
            f"{name[:200]!r} cannot name a sequence: it becomes part of file names (letters, digits, - _ .)"
        )
    return name


def listed(names: Sequence[str]) -> str:
    """Return the first names with commas between them, and how many more there are."""
    more = f" and {len(names) - _MAX_LISTED} more" if len(names) > _MAX_LISTED else ""
    return (", ".join(names[:_MAX_LISTED]) or "none") + more


def name_patterns(wanted: str) -> tuple[list[str], list[str]]:
    """Return the names and globs that ``seq`` asks for, and those that it leaves out with a leading -.

    Where it only leaves out, it asks for all; what it leaves out is so wherever it stands.
    """
    patterns = [pattern.strip() for pattern in wanted.split(",")]
    left_out = [pattern[1:] for pattern in patterns if pattern.startswith("-")]
    asked = ["*" if pattern == ALL else pattern for pattern in patterns if not pattern.startswith("-")]
    return asked or ["*"], left_out


def _selected(wanted: str, names: list[str]) -> list[str]:
    if wanted == ALL:
        return names
    asked, left_out = name_patterns(wanted)
    chosen = dict.fromkeys(name for pattern in asked for name in _matches(pattern, names))
    gone = {name for pattern in left_out for name in _matches(pattern, names)}
    if not (remaining := [name for name in chosen if name not in gone]):
        raise UserError(f"seq={wanted} leaves out every sequence that it names; leave some of them in")
    return remaining


def _matches(pattern: str, names: list[str]) -> list[str]:
    if not (found := fnmatch.filter(names, pattern)):
        raise UserError(
            f"there is no sequence {pattern}; the manifest has {listed(names)}. "
            "For files of your own: rig.calibration=PATH rig.videos='GLOB' seq=NAME"
        )
    return found


def _manifest_rows(manifest: str | None) -> dict[str, ManifestRow]:
    rows: dict[str, ManifestRow] = {}
    for path in _files(manifest) if manifest else [MANIFESTS / name for name in _DEFAULTS]:
        for row in _read_csv(path):
            if row["sequence_id"] in rows:
                raise UserError(f"{path}: the sequence {row['sequence_id']} stands in the manifest twice")
            rows[checked_name(row["sequence_id"])] = {**row, "manifest": str(path), "folder": str(path.parent)}
    return rows


def _files(manifest: str) -> list[Path]:
    """Return the files that a parameter names: paths or globs, with commas between them."""
    if Path(manifest).is_file():  # whose name has a comma
        return [Path(manifest)]
    found: list[Path] = []
    for pattern in manifest.split(","):
        paths = sorted(map(Path, glob.glob(pattern.strip())))
        if not paths:
            raise UserError(f"manifest={pattern} names no file")
        found += [path for path in paths if path not in found]
    return found


def _read_csv(path: Path) -> Iterator[ManifestRow]:
    try:
        with opened_csv(path, _MAX_BYTES) as reader:
            if missing := set(_COLUMNS) - set(reader.fieldnames or ()):
                raise UserError(
                    f"{path} has no column {', '.join(sorted(missing))}; a manifest has {', '.join(_COLUMNS)}"
                )
            for row in reader:
                yield {name: row.get(name) or "" for name in (*_COLUMNS, *_OPTIONAL)}
    except FormatError as error:
        raise UserError(str(error)) from error
