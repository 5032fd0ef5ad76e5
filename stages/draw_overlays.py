"""Draw the 3D joints over the pictures: a contact sheet, a sheet of the hands enlarged, and a film of all views."""

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import pyarrow as pa
from pydantic import Field

from assemblyhands_core.data.arrays import to_numpy
from assemblyhands_core.data.camera_rows import camera_from_row
from assemblyhands_core.data.catalog import BODY_KEYPOINTS, JOINTS, OVERLAYS, VIEWS
from assemblyhands_core.data.digests import digest_file
from assemblyhands_core.data.video import VideoReader, VideoWriter
from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.geometry.crops import square_box
from assemblyhands_core.hands.body import NUM_BODY_KEYPOINTS
from assemblyhands_core.hands.joints import HANDS, NUM_JOINTS, Hand
from assemblyhands_core.viz.overlays import contact_sheet, draw_body, draw_hand
from stages._contract import Context, Stage, StageConfig, Tables

Image = npt.NDArray[np.uint8]
Poses = Mapping[tuple[int, str], tuple[Any, Any]]  # (frame, hand or camera) → points, valid
_MIN_HAND_PX = 32.0  # an enlarged hand shows at least so much of the video, also when it is a single joint
_FILM_COLUMNS = 4
_FILM_CRF = 26
_NO_PICTURE = np.zeros((1, 1, 3), np.uint8)


class DrawOverlaysConfig(StageConfig):
    """Parameters of the pictures."""

    num_instants: int = Field(ge=1)
    tile_side_px: int = Field(ge=64)
    hand_tile_px: int = Field(ge=32)
    hand_gamma: float = Field(gt=1)
    film: bool
    max_film_frames: int = Field(ge=1)


@dataclass(frozen=True, eq=False)
class _View:
    """A view with everything that is drawn over it."""

    camera: Camera
    video: Path
    num_frames: int
    joints: Poses
    bodies: Poses

    def picture(self, frame: int, threads: int) -> Image | None:
        """Return a frame's picture, None where the view lacks it."""
        pictures = VideoReader(self.video, threads=threads).frames(frame, 1, on_missing="skip")
        return next((image for _, image in pictures), None)

    def film(self, config: DrawOverlaysConfig, num_frames: int, threads: int) -> Iterator[tuple[int, Image]]:
        """Yield frame number and reduced picture with skeletons."""
        reader = VideoReader(self.video, threads=threads)
        for frame, image in reader.frames(0, num_frames, 1, config.tile_side_px, on_missing="skip"):
            yield frame, self.drawn(image, frame)

    def drawn(self, image: Image, frame: int) -> Image:
        """Return a picture of this view, of any size, with the frame's skeletons over it."""
        camera = self.camera.scaled(image.shape[1], image.shape[0])
        picture = image
        if (body := self.bodies.get((frame, self.camera.camera_id))) is not None:
            scale = np.array([camera.width_px / self.camera.width_px, camera.height_px / self.camera.height_px])
            picture = draw_body(picture, (body[0] + 0.5) * scale - 0.5, body[1])
        for hand in HANDS:
            if (pose := self.joints.get((frame, hand))) is not None:
                picture = draw_hand(picture, camera.project(pose[0]), pose[1], hand)
        return picture

    def enlarged(self, config: DrawOverlaysConfig, image: Image, frame: int, hand: Hand) -> Image | None:
        """Return a hand cut out of a full-size picture with its joints, None where none lies on the picture."""
        points, valid = self.joints.get((frame, hand), (np.empty((0, 3)), None))
        pixels = self.camera.project(points)
        shown = pixels[self.camera.contains(pixels)]
        if not len(shown):
            return None
        center, side = square_box(shown, config.hand_gamma)
        scale = config.hand_tile_px / max(side, _MIN_HAND_PX)
        shift = config.hand_tile_px / 2 - 0.5 - scale * center
        window = np.array([[scale, 0, shift[0]], [0, scale, shift[1]]])
        tile = cv2.warpAffine(image, window, (config.hand_tile_px, config.hand_tile_px), flags=cv2.INTER_LINEAR)
        return draw_hand(np.asarray(tile, dtype=np.uint8), scale * pixels + shift, valid, hand)


def run(config: DrawOverlaysConfig, inputs: Tables, context: Context) -> Tables:
    """Draw one sequence."""
    joints = _poses(inputs["joints"], "hand", "joints_world_mm", (NUM_JOINTS, 3))
    bodies = _poses(inputs["body_keypoints"], "camera_id", "body_px", (NUM_BODY_KEYPOINTS, 2))
    views = [
        _View(camera_from_row(row), Path(row["video_file"]), row["num_frames"], joints, bodies)
        for row in inputs["views"].to_pylist()
        if row["valid"]
    ]
    _write_sheets(config, views, context)
    names = {"contact_sheet": "contact_sheet.png", "hands": "hands.png"}
    if config.film:
        rate_hz = float(np.median(to_numpy(inputs["views"].filter(inputs["views"]["valid"])["rate_hz"])))
        _write_film(config, views, rate_hz, context)
        names["film"] = "film.mp4"
    return {"overlays": OVERLAYS.from_rows([_row(context, kind, name) for kind, name in names.items()])}


def _row(context: Context, kind: str, name: str) -> dict[str, str]:
    return {
        "sequence_id": context.sequence_id,
        "kind": kind,
        "camera_id": "all",
        "overlay_file": name,
        "sha256": digest_file(context.blob_dir / name),
    }


def _poses(table: pa.Table, owner: str, points: str, shape: tuple[int, int]) -> Poses:
    values = to_numpy(table[points]).reshape(-1, *shape).astype(np.float64)
    valid = np.asarray(np.isfinite(values).all(axis=-1))
    keys = zip(to_numpy(table["frame"]).tolist(), to_numpy(table[owner]).tolist(), strict=True)
    return {key: (values[i], valid[i]) for i, key in enumerate(keys) if valid[i].any()}


def _write_sheets(config: DrawOverlaysConfig, views: Sequence[_View], context: Context) -> None:
    """Write the contact sheets of some instants, a row each, spread over the sequence: whole views, hands enlarged."""
    num_frames = max(view.num_frames for view in views)
    instants = np.linspace(0, num_frames - 1, config.num_instants + 2)[1:-1].round().astype(int).tolist()
    wholes: list[tuple[Image, str]] = []
    hands: list[tuple[Image, str]] = []
    for frame in dict.fromkeys(instants):
        for view in views:
            image, caption = view.picture(frame, context.num_threads), f"{view.camera.camera_id}  frame {frame}"
            if image is None:
                wholes.append((_NO_PICTURE, f"{caption}  missing"))
                hands += [(_NO_PICTURE, f"{caption}  missing")] * len(HANDS)
                continue
            wholes.append((view.drawn(_reduced(image, config.tile_side_px), frame), caption))
            for hand in HANDS:
                tile = view.enlarged(config, image, frame, hand)
                hands.append((_NO_PICTURE if tile is None else tile, f"{caption}  {hand}"))
    _write_png(context.blob_dir / "contact_sheet.png", wholes, len(views))
    _write_png(context.blob_dir / "hands.png", hands, len(HANDS) * len(views))


def _write_png(path: Path, tiles: Sequence[tuple[Image, str]], columns: int) -> None:
    sheet = contact_sheet([tile for tile, _ in tiles], columns, [caption for _, caption in tiles])
    path.write_bytes(cv2.imencode(".png", cv2.cvtColor(sheet, cv2.COLOR_RGB2BGR))[1].tobytes())


def _write_film(config: DrawOverlaysConfig, views: Sequence[_View], rate_hz: float, context: Context) -> None:
    """Write a film with all views side by side."""
    num_frames = min(config.max_film_frames, max(view.num_frames for view in views))
    captions = [view.camera.camera_id for view in views]
    sheets = (
        contact_sheet(pictures, min(_FILM_COLUMNS, len(views)), captions)
        for pictures in _lockstep(config, views, num_frames, context)
    )
    first = next(sheets)
    with VideoWriter(context.blob_dir / "film.mp4", first.shape[1], first.shape[0], rate_hz, crf=_FILM_CRF) as film:
        for sheet in itertools.chain([first], sheets):
            film.write(sheet)


def _lockstep(
    config: DrawOverlaysConfig, views: Sequence[_View], num_frames: int, context: Context
) -> Iterator[list[Image]]:
    """Yield the views' pictures frame by frame; where a view lacks a frame, its last picture stays."""
    streams = [view.film(config, num_frames, context.num_threads) for view in views]
    upcoming = [next(stream, None) for stream in streams]
    pictures = [_NO_PICTURE if item is None else item[1] for item in upcoming]
    for frame in range(num_frames):
        for v, item in enumerate(upcoming):
            if item is not None and item[0] == frame:
                pictures[v], upcoming[v] = item[1], next(streams[v], None)
        yield pictures


def _reduced(image: Image, max_side_px: int) -> Image:
    scale = min(1.0, max_side_px / max(image.shape[:2]))
    size = (round(image.shape[1] * scale), round(image.shape[0] * scale))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)


STAGE = Stage(
    name="draw_overlays",
    version=1,
    config=DrawOverlaysConfig,
    inputs={"views": VIEWS, "body_keypoints": BODY_KEYPOINTS, "joints": JOINTS},
    outputs={"overlays": OVERLAYS},
    run=run,
    shard="sequence",
)
