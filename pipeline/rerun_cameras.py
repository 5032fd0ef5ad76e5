"""The cameras that a run has of a sequence, as a file for rerun shows them: rectified, reduced, with what was seen."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Protocol

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from assemblyhands_core.data.arrays import to_numpy
from assemblyhands_core.data.camera_rows import camera_from_row
from assemblyhands_core.data.catalog import CHUNKS, KEYPOINTS, RECTIFIED_VIEWS, VIEWS
from assemblyhands_core.data.crop_images import ImageRGB
from assemblyhands_core.data.ego_tables import EGO_BOXES, EGO_FRAMES
from assemblyhands_core.data.ego_views import EgoView, ego_views
from assemblyhands_core.data.keypoint_rows import keypoints_by_view, positions
from assemblyhands_core.data.video import VideoReader
from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.geometry.regions import RemapGrid
from assemblyhands_core.hands.joints import HANDS
from assemblyhands_core.viz.rectified_pictures import PictureRectifier
from assemblyhands_core.viz.rerun_file import WORLD, EntityPath, RerunFile
from pipeline.sequence_tables import SequenceTables, between

_FIXED_DEPTH_MM: Final = 150.0  # how far from a camera its picture stands in the world's view
_HEADSET_DEPTH_MM: Final = 40.0  # its cameras are near one another

Frames = npt.NDArray[np.int64]


class ShownCamera(Protocol):
    """A camera of the sequence."""

    @property
    def path(self) -> EntityPath:
        """Return its entity."""

    @property
    def rectifier(self) -> PictureRectifier:
        """Return what makes its pictures."""

    def add_to(self, file: RerunFile, frames: Frames) -> None:
        """Add where it stands and what was seen in it."""

    def pictures(self, frames: Frames) -> Iterator[tuple[int, ImageRGB]]:
        """Yield its raw pictures, full or reduced; frames that it lacks are left out."""


@dataclass(frozen=True, eq=False)
class FixedCamera:
    """A camera that stands still.

    Attributes:
        raw: Of its video.
        rectifier: Of its pictures.
        video: The file.
        keypoints: Rows of `catalog.KEYPOINTS` about it.
        min_confidence: Keypoints below were not used.
    """

    raw: Camera
    rectifier: PictureRectifier
    video: Path
    keypoints: pa.Table
    min_confidence: float

    @property
    def path(self) -> EntityPath:
        """Return its entity."""
        return WORLD, "cameras", self.raw.camera_id

    def add_to(self, file: RerunFile, frames: Frames) -> None:
        """Add where it stands, and the 2D keypoints that triangulation used."""
        file.camera(self.path, self.rectifier.camera, _FIXED_DEPTH_MM)
        file.place(self.path, self.raw.T_camera_from_world)
        if not self.keypoints.num_rows:
            return
        for hand, pixels in zip(HANDS, self._keypoints(frames), strict=True):
            file.keypoints([*self.path, "keypoints", hand], frames, pixels, hand)

    def pictures(self, frames: Frames) -> Iterator[tuple[int, ImageRGB]]:
        """Yield its raw pictures, reduced."""
        shown = self.rectifier.camera
        step = int(frames[1] - frames[0]) if len(frames) > 1 else 1
        reader, side_px = VideoReader(self.video), max(shown.width_px, shown.height_px)
        yield from reader.frames(int(frames[0]), len(frames), step, side_px, on_missing="skip")

    def _keypoints(self, frames: Frames) -> npt.NDArray[np.float64]:
        """Return the keypoints (hand, frame, joint, 2) in the rectified pictures, NaN where there is none."""
        frame, hand = to_numpy(self.keypoints["frame"]), positions(self.keypoints["hand"], HANDS)
        place = np.minimum(np.searchsorted(frames, frame), len(frames) - 1)
        row = np.where(frames[place] == frame, hand * len(frames) + place, -1)
        view = np.zeros(len(row), dtype=np.int64)
        raw_px, _ = keypoints_by_view(self.keypoints, row, view, len(HANDS) * len(frames), 1, self.min_confidence)
        pixels = self.rectifier.camera.project_camera(self.raw.unproject_camera(raw_px[:, 0]))
        return pixels.reshape(len(HANDS), len(frames), -1, 2)


@dataclass(frozen=True, eq=False)
class HeadsetCamera:
    """A camera that moves with the head."""

    view: EgoView
    rectifier: PictureRectifier

    @property
    def path(self) -> EntityPath:
        """Return its entity."""
        return WORLD, "headset", self.view.camera_id

    def add_to(self, file: RerunFile, frames: Frames) -> None:
        """Add where it is at each frame that has a pose."""
        posed = np.array([frame for frame in frames.tolist() if frame in self.view.poses], dtype=np.int64)
        file.camera(self.path, self.rectifier.camera, _HEADSET_DEPTH_MM)
        if len(posed):
            file.places(self.path, posed, np.stack([self.view.poses[frame] for frame in posed.tolist()]))

    def pictures(self, frames: Frames) -> Iterator[tuple[int, ImageRGB]]:
        """Yield its pictures of frames at which it is known where it is."""
        has_own = self.view.image_files
        wanted = [f for f in frames.tolist() if f in self.view.poses and (not has_own or f in has_own)]
        for frame, picture in self.view.pictures(wanted, num_threads=1):
            if frame in wanted and not isinstance(picture, str):
                yield frame, picture


_FIXED: Final = ("ingest", "undistort")
_HEADSET: Final = ("ingest_ego", "undistort_ego")


def shown_cameras(
    tables: SequenceTables, first_frame: int, end_frame: int, max_side_px: int, min_confidence: float
) -> list[ShownCamera]:
    """Return the cameras of a sequence that were used, fixed ones first."""
    fixed = _fixed_cameras(tables, first_frame, end_frame, max_side_px, min_confidence)
    return [*fixed, *_headset_cameras(tables, first_frame, end_frame, max_side_px)]


def _fixed_cameras(
    tables: SequenceTables, first_frame: int, end_frame: int, max_side_px: int, min_confidence: float
) -> Iterator[FixedCamera]:
    keypoints = between(tables.read("detect_keypoints", "keypoints", KEYPOINTS), first_frame, end_frame)
    rectified = _rows(tables, _FIXED[1], "rectified_views")
    for name, row in _rows(tables, _FIXED[0], "views").items():
        if name in rectified:
            own = keypoints.filter(pa.compute.field("camera_id") == name)
            rectifier = _rectifier(rectified[name], max_side_px)
            yield FixedCamera(camera_from_row(row), rectifier, Path(row["video_file"]), own, min_confidence)


def _headset_cameras(
    tables: SequenceTables, first_frame: int, end_frame: int, max_side_px: int
) -> Iterator[HeadsetCamera]:
    node, undistort = _HEADSET
    chunk = {"chunk": 0, "first_frame": first_frame, "num_frames": end_frame - first_frame}
    found = {
        "views": tables.read(node, "views", VIEWS),
        "rectified_views": tables.read(undistort, "rectified_views", RECTIFIED_VIEWS),
        "frames": tables.read(node, "frames", EGO_FRAMES),
        "boxes": tables.read(node, "boxes", EGO_BOXES),
        "chunks": CHUNKS.from_rows([{"sequence_id": tables.sequence_id, **chunk}]),
    }
    for view in ego_views(found):
        yield HeadsetCamera(view, PictureRectifier(view.rectified, view.grid, max_side_px))


def _rows(tables: SequenceTables, node: str, table: str) -> dict[str, Mapping[str, Any]]:
    """Return the rows of cameras that were used, by name."""
    spec = VIEWS if table == VIEWS.name else RECTIFIED_VIEWS
    return {row["camera_id"]: row for row in tables.read(node, table, spec).to_pylist() if row["valid"]}


def _rectifier(row: Mapping[str, Any], max_side_px: int) -> PictureRectifier:
    return PictureRectifier(camera_from_row(row), RemapGrid.from_bytes(row["grid"]), max_side_px)
