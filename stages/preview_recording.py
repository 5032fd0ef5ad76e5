"""Show a synthetic recording at a glance: one instant as all cameras see it, without and with the true joints."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import pyarrow as pa
from pydantic import Field

from assemblyhands_core.data.catalog import OVERLAYS
from assemblyhands_core.data.digests import digest_file
from assemblyhands_core.data.ground_truth import TRUE_VIEWS
from assemblyhands_core.data.studio_tables import FOOTAGE, TAKES
from assemblyhands_core.data.video import VideoReader
from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.hands.joints import NUM_JOINTS
from assemblyhands_core.synthetic.session import Order
from assemblyhands_core.viz.overlays import contact_sheet, draw_hand
from stages._contract import Context, Stage, StageConfig, Tables

Image = npt.NDArray[np.uint8]
_COLUMNS = 4
_JPEG_QUALITY = 90
_PLAIN, _DRAWN = "contact_sheet", "contact_sheet_joints"
_HEADSET_UP = np.array([0.0, -1.0, 0.0])


class PreviewRecordingConfig(StageConfig):
    """Parameters of the pictures."""

    at_share: float = Field(ge=0, le=1)
    tile_side_px: int = Field(ge=64)


def run(config: PreviewRecordingConfig, inputs: Tables, context: Context) -> Tables:
    """Write two contact sheets."""
    order = Order.of(inputs["takes"])
    frame = round(config.at_share * (order.num_frames - 1))
    rig = order.build_rig()
    sheets: dict[str, list[Image]] = {_PLAIN: [], _DRAWN: []}
    for cameras, is_ego in ((rig.exo, False), (rig.ego, True)):
        tiles: dict[str, list[Image]] = {_PLAIN: [], _DRAWN: []}
        for camera_id, camera in cameras.items():
            image, quarters = _picture(inputs["footage"], camera_id, frame), _quarter_turns(camera) if is_ego else 0
            drawn = _with_joints(image, inputs["true_views"], camera_id, frame)
            tiles[_PLAIN].append(_tile(image, config, quarters))
            tiles[_DRAWN].append(_tile(drawn, config, quarters))
        for name in tiles if cameras else ():
            sheets[name].append(contact_sheet(tiles[name], _COLUMNS, list(cameras)))
    for name, parts in sheets.items():
        (context.blob_dir / f"{name}.jpg").write_bytes(_jpeg(np.vstack(parts)))
    return {"overlays": OVERLAYS.from_rows([_row(context, name) for name in sheets])}


def _jpeg(image: Image) -> bytes:
    options = [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY]
    return cv2.imencode(".jpg", cv2.cvtColor(image, cv2.COLOR_RGB2BGR), options)[1].tobytes()


def _picture(footage: pa.Table, camera_id: str, frame: int) -> Image:
    rows = [row for row in footage.to_pylist() if row["camera_id"] == camera_id]
    part = next(row for row in rows if 0 <= frame - row["first_frame"] < row["num_frames"])
    ((_, image),) = VideoReader(Path(part["video_file"]), threads=1).frames(frame - part["first_frame"], 1)
    return np.asarray(image, dtype=np.uint8)


def _with_joints(image: Image, views: pa.Table, camera_id: str, frame: int) -> Image:
    chosen = views.filter((pa.compute.field("camera_id") == camera_id) & (pa.compute.field("frame") == frame))
    for row in chosen.to_pylist():
        pixels = np.array(row["joints_px"]).reshape(NUM_JOINTS, 2)
        image = draw_hand(image, pixels, np.array(row["is_in_image"]), row["hand"])
    return image


def _quarter_turns(camera: Camera) -> int:
    """Return by how many quarter turns, anticlockwise, a picture of the headset gets upright."""
    right, down, _ = camera.T_camera_from_world[:3, :3] @ _HEADSET_UP
    if abs(down) >= abs(right):
        return 0 if down < 0 else 2
    return 1 if right > 0 else 3


def _tile(image: Image, config: PreviewRecordingConfig, quarter_turns: int) -> Image:
    turned = np.rot90(image, quarter_turns)
    scale = config.tile_side_px / max(turned.shape[:2])
    size = (round(turned.shape[1] * scale), round(turned.shape[0] * scale))
    return np.asarray(cv2.resize(np.ascontiguousarray(turned), size, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def _row(context: Context, name: str) -> dict[str, Any]:
    file = f"{name}.jpg"
    return {
        "sequence_id": context.sequence_id,
        "kind": name,
        "camera_id": "all",
        "overlay_file": file,
        "sha256": digest_file(context.blob_dir / file),
    }


STAGE = Stage(
    name="preview_recording",
    version=1,
    config=PreviewRecordingConfig,
    inputs={"takes": TAKES, "footage": FOOTAGE, "true_views": TRUE_VIEWS},
    outputs={"overlays": OVERLAYS},
    run=run,
    shard="sequence",
)
