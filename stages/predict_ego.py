"""Predict hands in egocentric crops with SVEgoNet: per crop, and both hands of an instant merged over the cameras.

A prediction is 2.5D: pixels, and depth beyond the wrist. It is lifted with the wrist's depth where a label tells it, as
the paper evaluates, else with the depth at which the hand has a mean hand's size (`geometry.lifting`).
"""

from collections.abc import Iterator
from itertools import groupby
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc
from pydantic import Field

from assemblyhands_core.data.arrays import to_numpy
from assemblyhands_core.data.catalog import JOINTS
from assemblyhands_core.data.crop_images import decode_image
from assemblyhands_core.data.ego_boxes import IDENTITIES
from assemblyhands_core.data.ego_tables import EGO_CROPS, EGO_HANDS
from assemblyhands_core.data.training_tables import WEIGHTS
from assemblyhands_core.geometry.lifting import lifted_mm, wrist_depth_of_size_mm
from assemblyhands_core.hands.joints import BONES, HANDS, NUM_JOINTS, WRIST
from assemblyhands_core.hands.kinematics import HandSkeleton
from stages._contract import Context, Stage, StageConfig, Tables
from stages._training import weights_file

SOURCE = "svegonet"

Floats = npt.NDArray[np.floating[Any]]
Row = dict[str, Any]


class PredictEgoConfig(StageConfig):
    """Parameters of prediction."""

    decoding: Literal["soft_argmax", "argmax"]
    batch_size: int = Field(ge=1)
    wrist_depth: Literal["label", "hand_size"]
    min_confidence: float = Field(ge=0, le=1)


def run(config: PredictEgoConfig, inputs: Tables, context: Context) -> Tables:
    """Predict the hands of one chunk of frames."""
    crops = inputs["crops"]
    hands = [*_holes(crops.filter(pc.invert(crops["valid"])))]
    if (valid := crops.filter(crops["valid"])).num_rows:
        hands += _predicted(config, valid, weights_file(inputs["weights"]), context)
    hands.sort(key=lambda row: (row["frame"], row["hand"], row["camera_id"]))
    joints = [_merged(list(rows)) for _, rows in groupby(hands, key=lambda row: (row["frame"], row["hand"]))]
    return {"hands": EGO_HANDS.from_rows(hands), "joints": JOINTS.from_rows(joints)}


def _predicted(config: PredictEgoConfig, crops: pa.Table, weights: Path, context: Context) -> Iterator[Row]:
    """Yield a row for each crop that there is."""
    # Importing torch takes seconds, which every command would pay at the head of this file.
    from assemblyhands_core.models.ego_prediction import predict_hands
    from assemblyhands_core.models.pretrained import load_svegonet
    from assemblyhands_core.models.warm import load_once

    names = crops.select(EGO_HANDS.key).to_pylist()
    found = predict_hands(
        load_once(load_svegonet, weights),
        [decode_image(image) for image in crops["image"].to_pylist()],
        [name["hand"] for name in names],
        batch_size=config.batch_size,
        num_threads=context.num_threads,
        decoding=config.decoding,
    )
    intrinsics_px = to_numpy(crops["intrinsics_px"]).astype(np.float64)
    depth_mm, source = _wrist_depths(config, crops, found.pixels, found.depth_mm, intrinsics_px)
    in_camera = lifted_mm(found.pixels, found.depth_mm, depth_mm, intrinsics_px)
    in_world = _in_world(in_camera, to_numpy(crops["T_camera_from_world"]).reshape(-1, 4, 4).astype(np.float64))
    for index, name in enumerate(names):
        is_sure = bool(found.confidence[index].mean() >= config.min_confidence)
        yield {
            **name,
            "joints_px": found.pixels[index].ravel(),
            "depth_mm": found.depth_mm[index],
            "confidence": found.confidence[index],
            "joints_camera_mm": in_camera[index].ravel(),
            "joints_world_mm": in_world[index].ravel(),
            "wrist_depth_mm": depth_mm[index],
            "wrist_depth_source": source[index],
            "identity": IDENTITIES[int(found.identity[index].argmax())],
            "identity_probability": found.identity[index],
            "valid": is_sure,
            "reason": "" if is_sure else "low_confidence",
        }


def _wrist_depths(
    config: PredictEgoConfig, crops: pa.Table, pixels: Floats, depth_mm: Floats, intrinsics_px: Floats
) -> tuple[Floats, list[str]]:
    """Return how far each wrist is from its camera, and who says so."""
    bones_mm = float(HandSkeleton.average().bone_lengths_mm.sum())
    by_size = wrist_depth_of_size_mm(pixels, depth_mm, intrinsics_px, BONES, bones_mm)
    own = np.array([HANDS.index(hand) for hand in crops["hand"].to_pylist()])
    joints = to_numpy(crops["joints_camera_mm"]).reshape(-1, len(HANDS), NUM_JOINTS, 3)
    labelled = joints[np.arange(len(own)), own, WRIST, 2].astype(np.float64)
    is_label = np.isfinite(labelled) & (config.wrist_depth == "label")
    return np.where(is_label, labelled, by_size), np.where(is_label, "label", "hand_size").tolist()


def _in_world(joints_mm: Floats, T_camera_from_world: Floats) -> Floats:
    rotation, shift = T_camera_from_world[:, :3, :3], T_camera_from_world[:, None, :3, 3]
    return np.asarray((joints_mm - shift) @ rotation)


def _holes(crops: pa.Table) -> Iterator[Row]:
    """Yield the rows of hands without crop."""
    unknown = np.full(NUM_JOINTS, np.nan)
    for name, reason in zip(crops.select(EGO_HANDS.key).to_pylist(), crops["reason"].to_pylist(), strict=True):
        yield {
            **name,
            "joints_px": np.tile(unknown, 2),
            "depth_mm": unknown,
            "confidence": np.zeros(NUM_JOINTS),
            "joints_camera_mm": np.tile(unknown, 3),
            "joints_world_mm": np.tile(unknown, 3),
            "wrist_depth_mm": np.nan,
            "wrist_depth_source": "",
            "identity": "",
            "identity_probability": np.full(3, np.nan),
            "valid": False,
            "reason": reason,
        }


def _merged(rows: list[Row]) -> Row:
    """Return a hand at an instant, merged over the cameras that see it: each joint's mean, weighted by confidence."""
    seen = [row for row in rows if row["valid"]]
    points, is_valid, reason = np.full((NUM_JOINTS, 3), np.nan), bool(seen), "" if seen else rows[0]["reason"]
    if seen:
        weights = np.stack([np.maximum(row["confidence"], 1e-6) for row in seen])[..., None]
        points = (np.stack([row["joints_world_mm"].reshape(-1, 3) for row in seen]) * weights).sum(0) / weights.sum(0)
    return {
        **{name: rows[0][name] for name in ("sequence_id", "frame", "hand")},
        "joints_world_mm": points.ravel(),
        "valid": np.full(NUM_JOINTS, is_valid),
        "reason": [reason] * NUM_JOINTS,
        "num_views": np.full(NUM_JOINTS, len(seen)),
        "reprojection_px": np.full(NUM_JOINTS, np.nan),
        "source": SOURCE,
        "round": 0,
    }


STAGE = Stage(
    name="predict_ego",
    version=1,
    config=PredictEgoConfig,
    inputs={"crops": EGO_CROPS, "weights": WEIGHTS},
    outputs={"hands": EGO_HANDS, "joints": JOINTS},
    run=run,
    shard="chunk",
    uses_gpu=True,
)
