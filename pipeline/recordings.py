"""Which sequences a run is about, and the files that each is made of."""

import glob
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

from assemblyhands_core.data.digests import FileDigests, digest_folder
from assemblyhands_core.data.json_files import FormatError
from assemblyhands_core.data.label_rows import FROM_FIRST_KEY
from assemblyhands_core.data.layout import DatasetLayout
from assemblyhands_core.data.packages import PackageError, fetch_package
from assemblyhands_core.data.split_files import ACTIONS_SHARE, EGO_SHARE, JOINTS_SHARE
from pipeline.config import RunConfig, UserError
from pipeline.graph import ACTION_EDGE, CORRECTION_EDGE, EGO_EDGE, LABEL_EDGE, SOURCE_EDGE, TRUTH_EDGE
from pipeline.manifests import MANIFESTS, ManifestRow, checked_name, select_rows
from pipeline.takes import CROPS_PACKAGE, HEADSET, STUDIO_PACKAGE, studio_folder

RELEASE_PACKAGE: Final = "assemblyhands"
"""What manifests call recordings of the AssemblyHands release, which the user has downloaded."""


@dataclass(frozen=True)
class Recording:
    """A sequence and its files.

    Attributes:
        sequence_id: its name, also in file names.
        calibration: the rig's calibration.
        videos: camera name (the file's stem) → file.
        keypoints: folder of 2D keypoints that come with it and take the place of detectors; None without any.
        detector: finds keypoints where none come with it.
        ground_truth: folder of what is true in it, for evaluation alone; None where nobody knows.
        labels: joints that people annotated, an AssemblyHands `joint_3d` file; None without any.
        ego_calibration: poses of its headset's cameras, an AssemblyHands `ego_calib` file; None without headset.
        ego_videos: the headset's raw videos by camera name.
        ego_images: the list of its rectified pictures instead, an AssemblyHands `ego_data` file; None without any.
        ego_image_folder: the folder of its pictures.
        corrections: 2D keypoints that people set by hand, see `correction_file`; None where nobody did.
        actions: what is being done when, a fine-grained CSV file of Assembly101; None where nobody says.
        label_name: how keys of the labels count, see `label_rows.FROM_FIRST_KEY`.
        split: what it is for: train, val, test; empty where nobody says.
    """

    sequence_id: str
    calibration: Path | None
    videos: Mapping[str, Path]
    keypoints: Path | None = None
    detector: str = "mediapipe"
    ground_truth: Path | None = None
    labels: Path | None = None
    ego_calibration: Path | None = None
    ego_videos: Mapping[str, Path] = field(default_factory=dict)
    ego_images: Path | None = None
    ego_image_folder: Path | None = None
    corrections: Path | None = None
    actions: Path | None = None
    label_name: str = "joint_3d"
    split: str = ""

    def origin_rows(self, digests: FileDigests) -> Mapping[str, Sequence[Mapping[str, str]]]:
        """Return role, name, path and sha256 of every file, apart for rig, labels, headset and truth; any may be empty.

        So nothing but the headset's part runs again when its files change, nothing but evaluation with the truth.
        """
        files = sorted(self.ground_truth.glob("*.parquet")) if self.ground_truth else []
        true = [("ground_truth", path.stem, path) for path in files]
        return {
            SOURCE_EDGE: self._rows(self._rig_files(), digests),
            LABEL_EDGE: self._rows(self._label_files(), digests),
            CORRECTION_EDGE: self._rows(self._correction_files(), digests),
            ACTION_EDGE: self._rows(self._timed_action_files(), digests),
            EGO_EDGE: self._rows(self._ego_files(), digests),
            TRUTH_EDGE: self._rows(true, digests),
        }

    def _rig_files(self) -> Iterator[tuple[str, str, Path]]:
        if self.calibration is not None and self.videos:
            yield "calibration", "calibration", self.calibration
            yield from (("video", name, path) for name, path in self.videos.items())

    def _label_files(self) -> Iterator[tuple[str, str, Path]]:
        if self.labels is not None:
            yield "labels", self.label_name, self.labels

    def _correction_files(self) -> Iterator[tuple[str, str, Path]]:
        if self.corrections is not None:
            yield "corrections", "corrections", self.corrections

    def _action_files(self) -> Iterator[tuple[str, str, Path]]:
        if self.actions is not None:
            yield "actions", "fine_grained", self.actions

    def _timed_action_files(self) -> Iterator[tuple[str, str, Path]]:
        """Yield with what is being done the labels that say at which key the release's pictures begin."""
        yield from self._action_files()
        if self.actions is not None and self.label_name == FROM_FIRST_KEY:
            yield from self._label_files()

    def _ego_files(self) -> Iterator[tuple[str, str, Path]]:
        if self.ego_calibration is None or not (self.ego_videos or self.ego_images):
            return
        yield "ego_calibration", "ego_calibration", self.ego_calibration
        yield from self._label_files()
        yield from self._action_files()
        if self.ego_images is not None and self.ego_image_folder is not None:
            yield "ego_images", "ego_data", self.ego_images
            yield "ego_image_folder", "images", self.ego_image_folder
        elif self.calibration is not None:
            yield "calibration", "calibration", self.calibration
            yield from (("ego_video", name, path) for name, path in self.ego_videos.items())

    def _rows(self, files: Iterable[tuple[str, str, Path]], digests: FileDigests) -> tuple[Mapping[str, str], ...]:
        return tuple(
            {
                "sequence_id": self.sequence_id,
                "role": role,
                "name": name,
                "source_file": str(path),
                "sha256": digests(path) if path.is_file() else digest_folder(path),
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
        name = checked_name(config.seq)
        found = _recording(name, Path(config.rig.calibration), config.rig.videos)
        return [replace(found, corrections=_existing(corrections_file(config, name)))]
    rows = select_rows(config)
    try:
        return [replace(_from_manifest(row, config), corrections=_corrections(row, config)) for row in rows]
    except FormatError as error:  # a name that would lead out of the data set's folder
        raise UserError(str(error)) from error


def corrections_file(config: RunConfig, sequence_id: str) -> Path | None:
    """Return where a sequence's corrections are, or would be; None where none are to be used."""
    return None if config.corrections is None else config.corrections.absolute() / f"{sequence_id}.csv"


def _corrections(row: ManifestRow, config: RunConfig) -> Path | None:
    """Return a row's corrections: those that the manifest names, or else those in the folder of them."""
    if config.corrections is None:
        return None
    named = _optional_file(Path(row["folder"]), row, "corrections")
    return named or _existing(corrections_file(config, row["sequence_id"]))


def _existing(path: Path | None) -> Path | None:
    return path if path is not None and path.is_file() else None


def synthetic_sequences(config: RunConfig) -> frozenset[str]:
    """Return which of the sequences that ``seq`` names are the studio's."""
    if config.rig.calibration is not None:
        return frozenset()
    return frozenset(
        row["sequence_id"] for row in select_rows(config) if row["package"] in (STUDIO_PACKAGE, CROPS_PACKAGE)
    )


def _from_manifest(row: ManifestRow, config: RunConfig) -> Recording:
    """Return a row's recording; its paths are relative to the package's files, or to the manifest's folder."""
    if row["package"] == RELEASE_PACKAGE:
        return from_release(row, release_folder(config))
    workspace = config.workspace
    if row["package"] == STUDIO_PACKAGE:
        row = {**row, **_studio_paths(row["sequence_id"], row["rig"], studio_folder(workspace))}
    folder = _package_folder(row, workspace) if row["package"] else Path(row["folder"])
    has_headset_alone = row["ego_videos"] and not row["videos"]
    videos = None if has_headset_alone else str(folder / row["videos"])
    found = _recording(row["sequence_id"], folder / row["calibration"], videos)
    return replace(
        found,
        keypoints=_optional_folder(folder, row, "keypoints"),
        detector="learned" if row["package"] == STUDIO_PACKAGE else found.detector,
        ground_truth=_optional_folder(folder, row, "ground_truth"),
        labels=_optional_file(folder, row, "labels"),
        actions=_optional_file(folder, row, "actions"),
        ego_calibration=_optional_file(folder, row, "ego_calibration"),
        ego_videos=_videos(row["sequence_id"], str(folder / row["ego_videos"])) if row["ego_videos"] else {},
        split=row["split"],
    )


def release_folder(config: RunConfig) -> DatasetLayout:
    """Return where the user has the AssemblyHands release.

    Raises:
        UserError: nobody says where.
    """
    if config.release is None:
        raise UserError(
            "say where the AssemblyHands release lies, the folder of `annotations` and `images`: release=PATH"
        )
    if not config.release.is_dir():
        raise UserError(f"release={config.release} is no folder: give that of `annotations` and `images`")
    return DatasetLayout(config.release.absolute())


def from_release(row: ManifestRow, layout: DatasetLayout) -> Recording:
    """Return a recording of the AssemblyHands release with what the user has of it (formats 2.1).

    Raises:
        UserError: there is nothing of it.
    """
    name, split = row["sequence_id"], row["split"]
    calibration = layout.exo_calibration(name)
    videos = {path.stem: path for path in sorted(calibration.parent.glob("*.mp4"))}
    labels, ego, images = (layout.annotations(split, kind) for kind in ("joint_3d", "ego_calib", "ego_data"))
    found = Recording(
        sequence_id=name,
        calibration=calibration if calibration.is_file() else None,
        videos=videos,
        labels=labels if labels.is_file() else None,
        label_name=FROM_FIRST_KEY,
        ego_calibration=ego if ego.is_file() else None,
        ego_images=images if images.is_file() else None,
        ego_image_folder=layout.ego_images(split, name),
        actions=_optional_file(Path(row["folder"]), row, "actions"),
        split=split,
    )
    if not (found.videos or found.ego_images or found.labels):
        raise UserError(f"sequence {name}: there is nothing of it below {layout.root}; `preflight` says what is")
    return found


def _studio_paths(sequence_id: str, rig: str, root: Path) -> dict[str, str]:
    """Return where a recording of the studio has its files, which its name decides alone; those of them that it has."""
    layout = DatasetLayout(Path())
    video, share = layout.video(sequence_id, "x"), layout.labels(sequence_id)
    paths = {
        "calibration": str(layout.calibration(sequence_id)),
        "videos": str(video.with_name("*_rgb.mp4")) if rig != HEADSET else "",
        "ground_truth": str(layout.ground_truth(sequence_id)),
    }
    if (root / share / JOINTS_SHARE).is_file():
        paths["labels"] = str(share / JOINTS_SHARE)
    if (root / share / ACTIONS_SHARE).is_file():
        paths["actions"] = str(share / ACTIONS_SHARE)
    if (root / share / EGO_SHARE).is_file():
        paths |= {"ego_calibration": str(share / EGO_SHARE), "ego_videos": str(video.with_name("HMC_*.mp4"))}
    return paths


def _optional_folder(folder: Path, row: ManifestRow, column: str) -> Path | None:
    path = (folder / row[column]).absolute() if row[column] else None
    if path is not None and not path.is_dir():
        raise UserError(f"sequence {row['sequence_id']}: the folder of {column} {path} does not exist")
    return path


def _optional_file(folder: Path, row: ManifestRow, column: str) -> Path | None:
    path = (folder / row[column]).absolute() if row[column] else None
    if path is not None and not path.is_file():
        raise UserError(f"sequence {row['sequence_id']}: the file of {column} {path} does not exist")
    return path


def _package_folder(row: ManifestRow, workspace: Path) -> Path:
    if row["package"] == STUDIO_PACKAGE:
        return studio_folder(workspace)
    pins = json.loads((MANIFESTS / "packages.json").read_text())
    if row["package"] not in pins:
        raise UserError(f"sequence {row['sequence_id']}: data_manifests/packages.json has no package {row['package']}")
    try:
        return fetch_package(
            row["package"], pins[row["package"]], workspace / "downloads", (row["calibration"], row["videos"])
        )
    except PackageError as error:
        raise UserError(str(error)) from error


def _recording(sequence_id: str, calibration: Path, videos: str | None) -> Recording:
    if not calibration.is_file():
        raise UserError(f"sequence {sequence_id}: the calibration {calibration} does not exist")
    return Recording(sequence_id, calibration.absolute(), _videos(sequence_id, videos) if videos else {})


def _videos(sequence_id: str, pattern: str) -> dict[str, Path]:
    files = sorted(Path(path) for path in glob.glob(pattern) if Path(path).is_file())
    if not files:
        raise UserError(f"sequence {sequence_id}: no video matches {pattern}")
    by_name = {path.stem: path.absolute() for path in files}
    if len(by_name) < len(files):
        raise UserError(
            f"sequence {sequence_id}: two videos that match {pattern} have the same name, so cameras get mixed up"
        )
    return by_name
