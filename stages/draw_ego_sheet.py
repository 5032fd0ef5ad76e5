"""Draw egocentric predictions: each crop with its labels and with what was predicted, and that from a fixed camera.

Depth errors hide in the picture that they were made from: the third column shows the same instant from the side.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import pyarrow as pa
from pydantic import Field

from assemblyhands_core.data.arrays import evenly_spread
from assemblyhands_core.data.camera_rows import camera_from_row
from assemblyhands_core.data.catalog import OVERLAYS, VIEWS
from assemblyhands_core.data.crop_images import decode_image
from assemblyhands_core.data.digests import digest_file
from assemblyhands_core.data.ego_tables import EGO_CROPS, EGO_HANDS
from assemblyhands_core.data.video import VideoReader
from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.geometry.crops import square_box
from assemblyhands_core.hands.joints import HANDS, NUM_JOINTS, Hand
from assemblyhands_core.viz.overlays import contact_sheet, draw_hand
from stages._contract import Context, Stage, StageConfig, Tables

Image = npt.NDArray[np.uint8]
Floats = npt.NDArray[np.floating[Any]]
_NO_PICTURE = np.zeros((1, 1, 3), np.uint8)
_COLUMNS = ("label", "predicted", "predicted, seen from")


class DrawEgoSheetConfig(StageConfig):
    """Parameters of the sheet."""

    num_crops: int = Field(ge=1)
    tile_px: int = Field(ge=64)
    gamma: float = Field(ge=1)


def run(config: DrawEgoSheetConfig, inputs: Tables, context: Context) -> Tables:
    """Draw one sequence; nothing where nothing was predicted."""
    pairs = _pairs(inputs["crops"], inputs["hands"])
    if not pairs:
        return {"overlays": OVERLAYS.empty()}
    views = [row for row in inputs["views"].to_pylist() if row["valid"]]
    tiles: list[tuple[Image, str]] = []
    for index in evenly_spread(len(pairs), config.num_crops):
        tiles += _row(config, *pairs[index], views, context)
    sheet = contact_sheet([tile for tile, _ in tiles], len(_COLUMNS), [caption for _, caption in tiles])
    path = context.blob_dir / "ego.png"
    path.write_bytes(cv2.imencode(".png", cv2.cvtColor(sheet, cv2.COLOR_RGB2BGR))[1].tobytes())
    row = {"sequence_id": context.sequence_id, "kind": "ego", "camera_id": "all", "overlay_file": path.name}
    return {"overlays": OVERLAYS.from_rows([{**row, "sha256": digest_file(path)}])}


def _pairs(crops: pa.Table, hands: pa.Table) -> list[tuple[Mapping[str, Any], Mapping[str, Any]]]:
    """Return the crops that a hand was predicted in, with it, by frame."""
    found = {tuple(row[name] for name in EGO_CROPS.key): row for row in hands.filter(hands["valid"]).to_pylist()}
    rows = sorted(crops.filter(crops["valid"]).to_pylist(), key=lambda row: (row["frame"], row["camera_id"]))
    keyed = [(tuple(row[name] for name in EGO_CROPS.key), row) for row in rows]
    return [(row, found[key]) for key, row in keyed if key in found]


def _row(
    config: DrawEgoSheetConfig,
    crop: Mapping[str, Any],
    hand: Mapping[str, Any],
    views: Sequence[Mapping[str, Any]],
    context: Context,
) -> list[tuple[Image, str]]:
    picture, scale = _enlarged(decode_image(crop["image"]), config.tile_px)
    own = HANDS.index(crop["hand"])
    label_px = np.reshape(crop["joints_px"], (len(HANDS), NUM_JOINTS, 2))[own]
    seen_px, world = (
        np.reshape(hand["joints_px"], (NUM_JOINTS, 2)),
        np.reshape(hand["joints_world_mm"], (NUM_JOINTS, 3)),
    )
    name = f"{crop['camera_id']}  frame {crop['frame']}"
    tiles = [_drawn(picture, (px + 0.5) * scale - 0.5, crop["hand"]) for px in (label_px, seen_px)]
    captions = [f"{column}, {crop['hand']} hand\n{name}" for column in _COLUMNS[:2]]
    side, side_name = _from_the_side(config, camera_from_row(crop), world, crop, views, context)
    return [*zip(tiles, captions, strict=True), (side, f"{_COLUMNS[2]}\n{side_name}")]


def _from_the_side(
    config: DrawEgoSheetConfig,
    ego: Camera,
    world: Floats,
    crop: Mapping[str, Any],
    views: Sequence[Mapping[str, Any]],
    context: Context,
) -> tuple[Image, str]:
    """Return the hand in the fixed camera that looks most squarely across the headset's camera."""
    cameras = {row["camera_id"]: camera_from_row(row) for row in views if crop["frame"] < row["num_frames"]}
    shown = {name: c for name, c in cameras.items() if c.contains(c.project(world)).all()}
    if not shown:
        return _NO_PICTURE, "nowhere"
    axis = ego.T_camera_from_world[2, :3]
    name = min(shown, key=lambda name: abs(float(axis @ shown[name].T_camera_from_world[2, :3])))
    video = next(Path(row["video_file"]) for row in views if row["camera_id"] == name)
    frames = VideoReader(video, threads=context.num_threads).frames(crop["frame"], 1, on_missing="skip")
    image = next((picture for _, picture in frames), None)
    if image is None:
        return _NO_PICTURE, name
    pixels = shown[name].project(world)
    center, side = square_box(pixels, config.gamma)
    scale = config.tile_px / side
    shift = config.tile_px / 2 - 0.5 - scale * center
    window = np.array([[scale, 0, shift[0]], [0, scale, shift[1]]])
    tile = np.asarray(cv2.warpAffine(image, window, (config.tile_px, config.tile_px)), dtype=np.uint8)
    return _drawn(tile, scale * pixels + shift, crop["hand"]), name


def _drawn(picture: Image, pixels: Floats, hand: Hand) -> Image:
    return draw_hand(picture, pixels.astype(np.float64), np.asarray(np.isfinite(pixels).all(axis=-1)), hand)


def _enlarged(picture: Image, size_px: int) -> tuple[Image, float]:
    enlarged = cv2.resize(picture, (size_px, size_px), interpolation=cv2.INTER_LINEAR)
    return np.asarray(enlarged, dtype=np.uint8), size_px / picture.shape[1]


STAGE = Stage(
    name="draw_ego_sheet",
    version=2,
    config=DrawEgoSheetConfig,
    inputs={"views": VIEWS, "crops": EGO_CROPS, "hands": EGO_HANDS},
    outputs={"overlays": OVERLAYS},
    run=run,
    shard="sequence",
)
