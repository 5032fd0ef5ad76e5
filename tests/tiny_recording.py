"""A tiny recording whose 3D truth is known: four small videos of a moving person, and what detectors see in them.

Everything is computed from fixed numbers, so that two recordings of the same name hold the same bytes.
"""

import json
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.parquet as pq

from assemblyhands_core.data.video import VideoWriter
from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.geometry.distortion import lens_from_coefficients
from assemblyhands_core.geometry.transforms import rigid
from assemblyhands_core.hands.body import ARMS, NUM_BODY_KEYPOINTS
from assemblyhands_core.hands.joints import HANDS, NUM_JOINTS, WRIST

NUM_FRAMES = 24
CHUNK_FRAMES = 6
NOISE_PX = 0.4
WIDTH_PX, HEIGHT_PX, FOCAL_PX = 320, 240, 260.0
CAMERA_IDS = ("front", "right", "back", "top")
_LENS = {"k1": -0.12, "k2": 0.02, "p1": 0.001, "p2": -0.0005}
_CENTERS_MM = {
    "front": (0, -300, -2300),
    "right": (-2200, -200, 600),
    "back": (400, -500, 2400),
    "top": (900, -2300, -600),
}
_AIM_MM = (0.0, -100.0, 0.0)
# Nose, eyes, ears, shoulders, elbows, wrists, hips, knees, ankles: left before right, y down, facing the front camera.
_BODY_MM = (
    (0, -650, -80), (35, -690, -60), (-35, -690, -60), (75, -660, 0), (-75, -660, 0), (190, -450, 0), (-190, -450, 0),
    (280, -200, -60), (-280, -200, -60), (200, -60, -260), (-200, -60, -260), (110, 50, 0), (-110, 50, 0),
    (120, 400, -20), (-120, 400, -20), (120, 700, 0), (-120, 700, 0),
)  # fmt: skip

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class TinyRecording:
    """The files of one recording, and its truth.

    Attributes:
        folder: holds ``calibration.json``, ``videos/<camera>.mp4``, ``body.parquet`` and ``hands.parquet``.
        cameras: the true cameras.
        joints_mm: (frames, hands, 21, 3) right hand first.
    """

    folder: Path
    cameras: dict[str, Camera]
    joints_mm: Floats

    @property
    def calibration(self) -> Path:
        """Return the calibration, Assembly101's JSON."""
        return self.folder / "calibration.json"

    def video(self, camera_id: str) -> Path:
        """Return one camera's video."""
        return self.folder / "videos" / f"{camera_id}.mp4"

    def overrides(self) -> list[str]:
        """Return what the command line takes to annotate this recording from its 2D keypoints."""
        return [
            f"rig.calibration={self.calibration}",
            f"rig.videos={self.folder}/videos/*.mp4",
            "seq=tiny",
            "rounds=0",  # it shows no hands
            *detector_overrides(self.folder),
            f"ingest.chunk_frames={CHUNK_FRAMES}",
        ]


def detector_overrides(folder: Path) -> list[str]:
    """Return the overrides that read 2D keypoints from a folder's files."""
    files = {"detect_hands": "body", "audit_recording": "body", "detect_keypoints": "hands"}
    return [f"{stage}.detector=precomputed" for stage in files] + [
        f"{stage}.options.precomputed.root={folder}/{name}.parquet" for stage, name in files.items()
    ]


def write_recording(folder: Path, seed: int = 0) -> TinyRecording:
    """Write a recording into a new folder; another seed is another performance."""
    (folder / "videos").mkdir(parents=True)
    cameras = {name: _camera(name) for name in CAMERA_IDS}
    body_mm, joints_mm = _performance(seed)
    generator = np.random.default_rng([seed, 1])
    recording = TinyRecording(folder, cameras, joints_mm)
    recording.calibration.write_text(json.dumps([_record(camera) for camera in cameras.values()]))
    _write_keypoints(folder / "body.parquet", "person", cameras, {0: body_mm}, generator)
    hands = {hand: joints_mm[:, h] for h, hand in enumerate(HANDS)}
    _write_keypoints(folder / "hands.parquet", "hand", cameras, hands, generator)
    for camera in cameras.values():
        _write_video(recording.video(camera.camera_id), camera, body_mm, generator)
    return recording


def _camera(name: str) -> Camera:
    forward = np.subtract(_AIM_MM, _CENTERS_MM[name])
    z = forward / np.linalg.norm(forward)
    x = np.cross((0.0, 1.0, 0.0), z)
    x /= np.linalg.norm(x)
    rotation = np.stack([x, np.cross(z, x), z])
    return Camera(
        name, WIDTH_PX, HEIGHT_PX, FOCAL_PX, FOCAL_PX, WIDTH_PX / 2 - 0.5, HEIGHT_PX / 2 - 0.5,
        lens_from_coefficients("OpenCV", _LENS), rigid(rotation, -rotation @ np.array(_CENTERS_MM[name])),
    )  # fmt: skip


def _record(camera: Camera) -> dict[str, Any]:
    coefficients = dict.fromkeys(["k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2", "p3", "p4"], 0.0) | _LENS
    block = {
        "DistortionModel": "OpenCV", "SerialNo": camera.camera_id,
        "ImageSizeX": camera.width_px, "ImageSizeY": camera.height_px,
        "ModelViewMatrix": camera.T_camera_from_world.tolist(),
        "fx": camera.fx_px, "fy": camera.fy_px, "cx": camera.cx_px, "cy": camera.cy_px,
    }  # fmt: skip
    return {"Camera": block | coefficients, "MountingLocation": "Exocentric", "Type": "OptiTrack Color Camera"}


def _performance(seed: int) -> tuple[Floats, Floats]:
    """Return the body (frames, 17, 3) and both hands (frames, hands, 21, 3): it sways, its hands turn."""
    time = np.arange(NUM_FRAMES) / 30.0
    phase = np.random.default_rng([seed, 0]).uniform(0, 2 * np.pi, 4)
    sway = 60.0 * np.stack([np.sin(4 * time + phase[0]), 0.3 * np.sin(6 * time + phase[1]), np.cos(3 * time)], axis=1)
    body = np.asarray(_BODY_MM, dtype=np.float64) + sway[:, None]
    hands = np.stack([_hand(body, hand, 5 * time + phase[2 + h]) for h, hand in enumerate(HANDS)], axis=1)
    return body, hands


def _hand(body: Floats, hand: Any, angle: Floats) -> Floats:
    """Return a spread hand (frames, 21, 3) beyond the wrist that turns about the forearm."""
    arm = ARMS[hand]
    wrist, elbow = body[:, arm.wrist], body[:, arm.elbow]
    along = (wrist - elbow) / np.linalg.norm(wrist - elbow, axis=1, keepdims=True)
    side = np.cross(along, (0.0, 1.0, 0.0))
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    turned = np.cos(angle)[:, None] * side + np.sin(angle)[:, None] * np.cross(along, side)
    joints = np.repeat(wrist[:, None], NUM_JOINTS, axis=1)
    for joint in range(WRIST):
        finger, end = divmod(joint, 4)  # end 0 is the tip, 3 the base
        joints[:, joint] += (85 + 30 * (3 - end)) * along + (finger - 2) * (18 + 5 * (3 - end)) * turned
    return joints


def _write_keypoints(
    path: Path, kind: str, cameras: dict[str, Camera], points_mm: dict[Any, Floats], generator: np.random.Generator
) -> None:
    rows = []
    for camera in cameras.values():
        for name, points in points_mm.items():
            pixels = camera.project(points)
            noisy = pixels + NOISE_PX * generator.standard_normal(pixels.shape)
            confidence = np.where(camera.contains(pixels), 0.9, 0.0)
            rows += [
                {"camera": camera.camera_id, "frame": f, kind: name, "keypoints_px": p.ravel(), "confidence": c}
                for f, (p, c) in enumerate(zip(noisy, confidence, strict=True))
            ]
    pq.write_table(pa.Table.from_pylist(rows), path)


def _write_video(path: Path, camera: Camera, body_mm: Floats, generator: np.random.Generator) -> None:
    """Write a textured room in which the person's keypoints are white squares."""
    room = np.kron(generator.integers(40, 160, (12, 16, 3)), np.ones((20, 20, 1))).astype(np.uint8)
    with VideoWriter(path, WIDTH_PX, HEIGHT_PX, Fraction(30)) as video:
        for pixels in np.rint(camera.project(body_mm)).astype(int):
            picture = room.copy()
            for x, y in pixels:
                picture[max(0, y - 3) : max(0, y + 4), max(0, x - 3) : max(0, x + 4)] = 255
            video.write(picture)


assert len(_BODY_MM) == NUM_BODY_KEYPOINTS
