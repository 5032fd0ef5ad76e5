"""A tiny world for the stages: somebody moves before a ring of cameras, and detectors see exactly what is there."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from assemblyhands_core.data.camera_rows import camera_to_row, missing_camera_row
from assemblyhands_core.data.catalog import CHUNKS, VIEWS
from assemblyhands_core.detectors.base import BodyDetections
from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.geometry.distortion import OpenCVLens
from stages._contract import Context
from stages.undistort import STAGE as UNDISTORT
from stages.undistort import UndistortConfig

NUM_FRAMES = 12
DISTANCE_MM = 3000.0
LENS = OpenCVLens(k1=-0.1, k2=0.02, p1=1e-3)
# COCO-17: nose, eyes, ears, shoulders, elbows, wrists, hips, knees, ankles; left before right, y down.
_BODY_MM = np.array(
    [
        *[(0, -650, -80), (35, -690, -60), (-35, -690, -60), (75, -660, 0), (-75, -660, 0), (190, -450, 0)],
        *[(-190, -450, 0), (280, -200, -60), (-300, -210, -40), (200, -60, -260), (-190, -80, -250), (110, 50, 0)],
        *[(-110, 50, 0), (120, 400, -20), (-120, 400, -20), (120, 700, 0), (-120, 700, 0)],
    ],
    dtype=np.float64,
)

_RECTIFIED: dict[str, pa.Table] = {}  # by the digest of the views


def _camera(name: str, angle_rad: float) -> Camera:
    """A camera on a circle around the origin, looking at it."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    pose = np.array([[c, 0, s, 0], [0, 1, 0, 0], [-s, 0, c, DISTANCE_MM], [0, 0, 0, 1.0]])
    return Camera(name, 640, 480, 500.0, 500.0, 319.5, 239.5, LENS, pose)


def _walk(num_frames: int) -> np.ndarray:
    """Return (F, 17, 3): the person sways unevenly, arms and all."""
    t = np.arange(num_frames)[:, None]
    sway = np.concatenate([80 * np.sin(t / 3), 15 * np.cos(t / 2), 50 * np.sin(t / 4 + 1)], axis=1)
    body = _BODY_MM + sway[:, None]
    body[:, [9, 10], 1] -= 40 * np.sin(t / 2)
    return body


@dataclass
class World:
    """The cameras, who moves where, and the tables that earlier stages would have made of it."""

    cameras: list[Camera] = field(
        default_factory=lambda: [_camera(n, a) for n, a in (("a", 0.0), ("b", 0.9), ("c", 2.2), ("d", -1.1))]
    )
    body_mm: np.ndarray = field(default_factory=lambda: _walk(NUM_FRAMES))

    def views(self, unusable: Mapping[str, str] | None = None, **columns: Any) -> pa.Table:
        """Return the table ``views``; ``unusable`` says of which cameras nothing is known and why."""
        rows = []
        for camera in self.cameras:
            reason = (unusable or {}).get(camera.camera_id, "")
            row = {"sequence_id": "s", "camera_id": camera.camera_id, "video_file": "", "video_sha256": ""}
            row |= {"num_frames": len(self.body_mm), "rate_hz": 30.0, "image_fit": "same", "note": ""}
            row |= missing_camera_row() if reason else camera_to_row(camera)
            rows.append(row | {"valid": not reason, "reason": reason} | columns)
        return VIEWS.from_rows(rows)

    def rectified(self, views: pa.Table) -> pa.Table:
        """Return the table ``rectified_views`` that the stage undistort makes of views, each made once."""
        key = VIEWS.digest(views)
        if key not in _RECTIFIED:
            _RECTIFIED[key] = self._rectify(views)
        return _RECTIFIED[key]

    def _rectify(self, views: pa.Table) -> pa.Table:
        config = UndistortConfig(
            focal_scale_perspective=1.0,
            focal_scale_fisheye=0.7,
            grid_step_px=16,
            lattice_step_px=32,
            max_residual_px=0.05,
            materialize=False,
            video_crf=18,
        )
        return UNDISTORT.run(config, {"views": views}, Context(Path(), "s"))["rectified_views"]

    def chunk(self, first: int = 0, count: int | None = None) -> pa.Table:
        """Return the one row of the table ``chunks`` that a shard gets."""
        count = len(self.body_mm) - first if count is None else count
        return CHUNKS.from_rows([{"sequence_id": "s", "chunk": 0, "first_frame": first, "num_frames": count}])


@dataclass
class ExactBodies:
    """A body detector that needs no image: it projects the bodies of a world.

    Attributes:
        persons_mm: each (F, 17, 3).
        late: camera → by how many frames it runs late.
        offset_px: camera → how far off its calibration everything is seen.
        is_hidden: (camera, frame) → COCO keypoints that are not seen there.
        asked: every (camera, frame) that was looked at.
    """

    cameras: Sequence[Camera]
    persons_mm: Sequence[np.ndarray]
    late: Mapping[str, int] = field(default_factory=dict)
    offset_px: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    is_hidden: Callable[[str, int], Sequence[int]] = lambda camera_id, frame: ()
    needs_image: bool = False
    asked: list[tuple[str, int]] = field(default_factory=list)

    def detect(self, image_rgb: np.ndarray | None, camera_id: str, frame: int) -> BodyDetections:
        """Return every person that has a keypoint on the image."""
        self.asked.append((camera_id, frame))
        camera = next(camera for camera in self.cameras if camera.camera_id == camera_id)
        shown = max(0, frame - self.late.get(camera_id, 0))
        pixels = np.stack([camera.project(person[shown]) for person in self.persons_mm] or [np.empty((0, 2))])
        pixels = pixels.reshape(-1, 17, 2) + self.offset_px.get(camera_id, (0.0, 0.0))
        is_seen = camera.contains(pixels)
        is_seen[:, list(self.is_hidden(camera_id, frame))] = False
        has_any = is_seen.any(axis=1)
        pixels, is_seen = pixels[has_any], is_seen[has_any]
        return BodyDetections(np.where(is_seen[..., None], pixels, np.nan), np.where(is_seen, 0.9, 0.0))


@pytest.fixture
def world() -> World:
    """Return four cameras around somebody who moves for twelve frames."""
    return World()


@pytest.fixture
def exact_bodies(world: World) -> Callable[..., ExactBodies]:
    """Return a maker of detectors that see the world's person, and whom else they are told."""

    def make(*others_mm: np.ndarray, **how: Any) -> ExactBodies:
        return ExactBodies(world.cameras, [world.body_mm, *others_mm], **how)

    return make


@pytest.fixture
def walk() -> Callable[[int], np.ndarray]:
    """Return a maker of longer walks, (F, 17, 3)."""
    return _walk
