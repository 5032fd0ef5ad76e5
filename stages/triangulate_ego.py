"""Triangulate hands from the headset's cameras alone: the egocentric baseline of the paper's tables (Sec. 3.1 and 5).

The same 2D network as for the fixed cameras looks at the crops, and the same robust triangulation joins the up to four
views of an instant. Boxes are those of the crops, so that nothing is compared but how hands are found in them.
"""

from collections.abc import Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any, Self

import numpy as np
import numpy.typing as npt
from pydantic import Field

from assemblyhands_core.data.camera_rows import camera_from_row
from assemblyhands_core.data.catalog import JOINTS
from assemblyhands_core.data.crop_images import decode_image
from assemblyhands_core.data.ego_tables import EGO_CROPS
from assemblyhands_core.data.outcomes import outcome_columns
from assemblyhands_core.data.strays import without_strays
from assemblyhands_core.detectors.base import HandCrop, HandDetection, detect_hands_in
from assemblyhands_core.detectors.registry import create_hand_detector
from assemblyhands_core.geometry.triangulation import triangulate
from assemblyhands_core.hands.joints import NUM_JOINTS
from stages._contract import Context, Stage, Tables
from stages._detector_config import DetectorConfig, detector_externals

SOURCE = "ego_triangulation"
_AT_ONCE = 64  # crops that are decoded at a time

Row = Mapping[str, Any]
Seen = tuple[Row, HandDetection]
Floats = npt.NDArray[np.float64]


class TriangulateEgoConfig(DetectorConfig):
    """Parameters of the baseline; pixels are those of the crops."""

    max_reprojection_px: float = Field(gt=0)
    min_confidence: float = Field(ge=0, le=1)
    min_views: int = Field(ge=2)
    min_parallax_rad: float = Field(ge=0, lt=np.pi)
    max_span_mm: float = Field(gt=0)

    def resolved(self, keypoints: Path | None, detector: str) -> Self:
        """Return the configuration with the detector that runs; keypoints of raw pictures are not those of crops."""
        return super().resolved(None, detector)


def run(config: TriangulateEgoConfig, inputs: Tables, context: Context) -> Tables:
    """Triangulate one chunk; a row for each hand at each instant of which there are crops or holes.

    Raises:
        ValueError: The detector does not look at pictures.
    """
    crops = sorted(inputs["crops"].to_pylist(), key=lambda row: (row["frame"], row["hand"], row["camera_id"]))
    valid = [crop for crop in crops if crop["valid"]]
    seen = dict(zip(map(_view, valid), _detected(config, valid, context), strict=True))
    rows = []
    for (frame, hand), views in groupby(crops, key=lambda row: (row["frame"], row["hand"])):
        all_views = list(views)
        found = [(crop, hit) for crop in all_views if (hit := seen.get(_view(crop))) is not None]
        name = {"sequence_id": context.sequence_id, "frame": frame, "hand": hand}
        rows.append({**name, **_joined(config, found), "source": SOURCE, "round": 0})
    return {"joints": JOINTS.from_rows(rows)}


def _detected(config: TriangulateEgoConfig, crops: Sequence[Row], context: Context) -> Sequence[HandDetection | None]:
    if not crops:
        return []
    detector = create_hand_detector(config.detector, **config.detector_options(context.sequence_id))
    if not detector.needs_image:
        raise ValueError(f"detector {config.detector} knows raw pictures alone, these are crops: choose another one.")
    parts = (crops[first : first + _AT_ONCE] for first in range(0, len(crops), _AT_ONCE))
    return [hit for part in parts for hit in detect_hands_in(detector, [_asked(crop) for crop in part])]


def _asked(crop: Row) -> HandCrop:
    return HandCrop(decode_image(crop["image"]), crop["hand"], crop["camera_id"], crop["frame"])


def _view(crop: Row) -> tuple[int, str, str]:
    return crop["frame"], crop["hand"], crop["camera_id"]


def _joined(config: TriangulateEgoConfig, seen: Sequence[Seen]) -> dict[str, Any]:
    """Return the joint columns of a hand from the views that found it; holes where fewer than needed did."""
    pixels, confidence = _used(config, seen)
    columns = _hole() if len(seen) < config.min_views else _triangulated(config, seen, pixels, confidence)
    is_unseen = ~(confidence > 0).any(axis=1)
    return columns | {"reason": np.where(is_unseen, "no_detection", columns["reason"])}


def _used(config: TriangulateEgoConfig, seen: Sequence[Seen]) -> tuple[Floats, Floats]:
    """Return pixels (21, view, 2), NaN where a view did not see the joint well enough, and confidence, 0 there."""
    pixels, confidence = np.full((NUM_JOINTS, len(seen), 2), np.nan), np.zeros((NUM_JOINTS, len(seen)))
    for view, (_, hit) in enumerate(seen):
        is_sure = hit.confidence >= config.min_confidence
        pixels[is_sure, view], confidence[is_sure, view] = hit.keypoints_px[is_sure], hit.confidence[is_sure]
    return pixels, confidence


def _hole() -> dict[str, Any]:
    return {
        "joints_world_mm": np.full(3 * NUM_JOINTS, np.nan),
        "valid": np.zeros(NUM_JOINTS, dtype=bool),
        "reason": np.full(NUM_JOINTS, "too_few_views", dtype=object),
        "num_views": np.zeros(NUM_JOINTS),
        "reprojection_px": np.full(NUM_JOINTS, np.nan),
    }


def _triangulated(
    config: TriangulateEgoConfig, seen: Sequence[Seen], pixels: Floats, confidence: Floats
) -> dict[str, Any]:
    found = triangulate(
        pixels,
        [camera_from_row(crop) for crop, _ in seen],
        confidence,
        max_reprojection_px=config.max_reprojection_px,
        min_views=config.min_views,
        min_parallax_rad=config.min_parallax_rad,
    )
    found = without_strays(found, config.max_span_mm)
    columns = {name: values[0] for name, values in outcome_columns(found, NUM_JOINTS).items()}
    return {"joints_world_mm": found.points_world_mm.ravel(), **columns}


STAGE = Stage(
    name="triangulate_ego",
    version=2,
    config=TriangulateEgoConfig,
    inputs={"crops": EGO_CROPS},
    outputs={"joints": JOINTS},
    run=run,
    shard="chunk",
    externals=detector_externals,
)
