"""Annotate hands with MVExoNet once: from the joints of one round to those of the next (paper, Sec. 3.1, supplement B).

The network is frozen; only windows and root change from round to round. An estimate that cannot be believed does not
count: then the joints of the round before are kept, and the table `rounds` says why.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from itertools import compress
from pathlib import Path
from typing import Any, Final, Self

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc
from pydantic import Field, model_validator

from assemblyhands_core.data.arrays import to_numpy
from assemblyhands_core.data.camera_rows import valid_cameras
from assemblyhands_core.data.catalog import (
    CORRECTIONS,
    CROPS,
    HAND_BOXES,
    JOINTS,
    KEYPOINTS,
    RECTIFIED_VIEWS,
    ROUNDS,
    VIEWS,
)
from assemblyhands_core.data.corrections import loose_notes, with_corrections, with_held_joints
from assemblyhands_core.data.digests import digest_file
from assemblyhands_core.data.hand_crops import stored_hands
from assemblyhands_core.data.keypoint_rows import distances_px, keypoints_by_view, positions, rows_of_hands
from assemblyhands_core.data.label_rows import MANUAL
from assemblyhands_core.data.round_guard import Estimates, doubts
from assemblyhands_core.data.round_outcomes import (
    CONVERGED,
    KEPT,
    NO_ROOT,
    TOO_FEW_VIEWS,
    RoundOutcome,
    displacement_mm,
    mean_of_known,
)
from assemblyhands_core.data.rounds import (
    TRUE_ROUND,
    HandWindows,
    KnownHand,
    WindowRule,
    hand_windows,
    joints_or_nan,
    known_hands,
)
from assemblyhands_core.hands.blending import blended_mm
from assemblyhands_core.hands.divergence import Limits
from assemblyhands_core.hands.joints import NUM_JOINTS
from stages._contract import Context, Stage, StageConfig, Tables

SHIPPED_WEIGHTS: Final = "weights/mvexonet.safetensors"
_REPOSITORY: Final = Path(__file__).resolve().parents[1]

Floats = npt.NDArray[np.floating[Any]]
Texts = npt.NDArray[np.object_]


def weights_path(name: str) -> Path:
    """Return where weights are: relative to the repository, or absolute."""
    return (_REPOSITORY / name).resolve()


class GuardConfig(StageConfig):
    """What is still believed of an estimate, see `divergence.Limits`."""

    max_displacement_mm: float = Field(gt=0)
    max_body_distance_mm: float = Field(gt=0)
    min_size: float = Field(ge=0)
    max_size: float = Field(gt=0)
    max_bone_mm: float = Field(gt=0)
    max_reprojection_ratio: float = Field(ge=1)
    min_reprojection_px: float = Field(ge=0)
    min_view_share: float = Field(ge=0, le=1)
    max_spread_ratio: float = Field(ge=1)
    max_course_px_ratio: float = Field(ge=1)
    min_instants: int = Field(ge=2)

    @model_validator(mode="after")
    def _bounds_are_in_order(self) -> Self:
        if self.min_size >= self.max_size:
            raise ValueError(f"min_size={self.min_size} has to be below max_size={self.max_size}")
        return self

    def limits(self) -> Limits:
        """Return it as the guard takes it."""
        return Limits(**self.model_dump())


class BlendConfig(StageConfig):
    """How much 2D + triangulation counts in what a round finds, see `blending.blended_mm`."""

    share: float = Field(ge=0, lt=1)
    within_mm: float = Field(ge=0)


class AnnotateRoundConfig(StageConfig):
    """Parameters of a round, the same for all rounds."""

    weights: str
    gamma: float = Field(ge=1, le=6)
    min_box_joints: int = Field(ge=2, le=NUM_JOINTS)
    min_inside: float = Field(gt=0, le=1)
    min_views: int = Field(ge=1)
    min_confidence: float = Field(ge=0, le=1)
    min_keypoint_confidence: float = Field(ge=0, le=1)
    batch_size: int = Field(ge=1)
    stop_below_mm: float = Field(ge=0)
    blend: BlendConfig
    guard: GuardConfig

    @property
    def weights_path(self) -> Path:
        """Return where the weights are."""
        return weights_path(self.weights)

    def window_rule(self) -> WindowRule:
        """Return how windows are chosen."""
        return WindowRule(self.gamma, self.min_box_joints, self.min_inside)


def run(config: AnnotateRoundConfig, inputs: Tables, context: Context) -> Tables:
    """Annotate one chunk of frames; one row for each hand and instant of the round before."""
    corrections = inputs.get("corrections", CORRECTIONS.empty())
    inputs = {**inputs, "keypoints": with_corrections(inputs["keypoints"], corrections)}
    previous = inputs["joints"]
    if not previous.num_rows:
        return {"joints": JOINTS.empty(), "rounds": ROUNDS.empty()}
    known = known_hands(previous, inputs["hand_boxes"])
    windows = _windows(config, known, inputs)
    reason, note = _reasons_not_to_ask(config, windows, inputs)
    joints, confidence = _asked(config, windows, reason == "", context)
    measured_px = _distances_to_keypoints(config, inputs)
    estimates = _beside_others(inputs, known, windows, joints, measured_px)
    is_judged = (reason == "") & (to_numpy(previous["round"]) != TRUE_ROUND)  # beside the truth every estimate is bad
    doubt, figures = doubts(estimates, is_judged, config.guard.limits())
    blended = blended_mm(joints, estimates.triangulated_world_mm, config.blend.share, config.blend.within_mm)
    outcome = RoundOutcome(
        previous=previous,
        windows=windows,
        joints_world_mm=blended,
        confidence=confidence,
        reprojection_px=mean_of_known(measured_px(blended), axis=1),
        reason=np.where(doubt == "", reason, doubt),
        note=np.where(doubt == "", note, figures),
        min_confidence=config.min_confidence,
    )
    return _corrected({"joints": outcome.joints(), "rounds": outcome.rounds()}, inputs["triangulated"], corrections)


def _corrected(found: Tables, triangulated: pa.Table, corrections: pa.Table) -> Tables:
    """Return a round's tables with the joints that people hold, and what is said of those that they do not."""
    if not corrections.num_rows:
        return found
    rounds = found["rounds"]
    notes = zip(rounds["note"].to_pylist(), loose_notes(rounds, corrections), strict=True)
    joined = pa.array(["; ".join(filter(None, pair)) for pair in notes], pa.string())
    rounds = rounds.set_column(rounds.schema.get_field_index("note"), rounds.schema.field("note"), joined)
    return {"joints": with_held_joints(found["joints"], triangulated, corrections), "rounds": rounds}


def _windows(config: AnnotateRoundConfig, known: Sequence[KnownHand], inputs: Tables) -> list[HandWindows]:
    rectified = valid_cameras(inputs["rectified_views"])
    matrices = {name: camera.P_pixel_from_world for name, camera in rectified.items()}
    stored = stored_hands(inputs["crops"])
    return [hand_windows(hand, stored.get(hand.key), matrices, config.window_rule()) for hand in known]


def _reasons_not_to_ask(
    config: AnnotateRoundConfig, windows: Sequence[HandWindows], inputs: Tables
) -> tuple[Texts, Texts]:
    """Return for each hand why the network is not asked, empty where it is, and the same with figures."""
    moved_mm = displacement_mm(joints_or_nan(inputs["joints"]), _earlier(inputs))
    is_own = ~pc.starts_with(inputs["joints"]["source"], KEPT).to_numpy(zero_copy_only=False)
    is_own &= (to_numpy(inputs["joints"]["source"]) != MANUAL) | (moved_mm > 0)  # a kept hand has not moved
    reason, note = (np.full(len(windows), "", dtype=object) for _ in range(2))
    for index, hand in enumerate(windows):
        if is_own[index] and moved_mm[index] < config.stop_below_mm:
            reason[index], note[index] = CONVERGED, f"moved {moved_mm[index]:.2f} mm in the round before"
        elif len(hand.views) < config.min_views:
            reason[index], note[index] = TOO_FEW_VIEWS, f"{len(hand.views)} views, {config.min_views} are needed"
        elif not np.isfinite(hand.root_world_mm).all():
            reason[index], note[index] = NO_ROOT, "neither its middle MCP nor the body says where it is"
    return reason, note


def _earlier(inputs: Tables) -> Floats:
    """Return the joints (G, 21, 3) of the round before the previous one, NaN where there is none."""
    previous, earlier = inputs["joints"], inputs["earlier_joints"]
    place = rows_of_hands(previous, earlier)
    is_earlier = place >= 0
    is_earlier[is_earlier] = to_numpy(earlier["round"])[place[is_earlier]] < to_numpy(previous["round"])[is_earlier]
    points = np.full((previous.num_rows, NUM_JOINTS, 3), np.nan)
    points[is_earlier] = joints_or_nan(earlier)[place[is_earlier]]
    return points


def _beside_others(
    inputs: Tables,
    known: Sequence[KnownHand],
    windows: Sequence[HandWindows],
    joints: Floats,
    measured_px: Callable[[Floats], Floats],
) -> Estimates:
    """Return the new joints with what they are judged by."""
    previous = inputs["joints"]
    place = rows_of_hands(previous, inputs["triangulated"])
    triangulated = np.where((place >= 0)[:, None, None], joints_or_nan(inputs["triangulated"])[place], np.nan)
    all_joints = (joints, joints_or_nan(previous), triangulated)
    now_px, before_px, first_px = (measured_px(points) for points in all_joints)
    stood_on = mean_of_known(np.where(to_numpy(previous["valid"]), to_numpy(previous["num_views"]), np.nan), axis=1)
    return Estimates(
        known=known,
        joints_world_mm=joints,
        triangulated_world_mm=triangulated,
        distances_px=now_px,
        previous_px=before_px,
        triangulated_px=first_px,
        previous_view_share=stood_on / np.maximum([len(hand.views) for hand in windows], 1),
    )


def _distances_to_keypoints(config: AnnotateRoundConfig, inputs: Tables) -> Callable[[Floats], Floats]:
    """Return what measures how far joints (G, 21, 3) are from the 2D keypoints (G, V, 21) of the hands."""
    keypoints, previous, cameras = inputs["keypoints"], inputs["joints"], valid_cameras(inputs["views"])
    place = rows_of_hands(keypoints, previous), positions(keypoints["camera_id"], list(cameras))
    shape = previous.num_rows, len(cameras)
    seen_px, _ = keypoints_by_view(keypoints, *place, *shape, config.min_keypoint_confidence)
    return partial(distances_px, cameras=list(cameras.values()), pixels=seen_px)


def _asked(
    config: AnnotateRoundConfig, windows: Sequence[HandWindows], is_asked: npt.NDArray[np.bool_], context: Context
) -> tuple[Floats, Floats]:
    """Return joints (G, 21, 3) and confidence (G, 21) that the network gives, NaN where it is not asked."""
    joints, confidence = np.full((len(windows), NUM_JOINTS, 3), np.nan), np.full((len(windows), NUM_JOINTS), np.nan)
    if is_asked.any():
        # Importing torch takes seconds, which every command would pay at the head of this file.
        from assemblyhands_core.models.annotation import estimate_hands
        from assemblyhands_core.models.pretrained import load_mvexonet
        from assemblyhands_core.models.warm import load_once

        hands = list(compress(windows, is_asked))
        network = load_once(load_mvexonet, config.weights_path)
        found = estimate_hands(network, hands, config.batch_size, context.num_threads)
        joints[is_asked], confidence[is_asked] = found.joints_world_mm, found.confidence
    return joints, confidence


def _externals(config: AnnotateRoundConfig, sequence_id: str) -> Mapping[str, str]:
    """Return the digest of the weights.

    Raises:
        ValueError: There is no such file.
    """
    if not config.weights_path.is_file():
        raise ValueError(
            f"There are no weights at {config.weights_path}: run `make train`, or say where they are by "
            "annotate_round.weights=PATH."
        )
    return {"weights": digest_file(config.weights_path)}


STAGE = Stage(
    name="annotate_round",
    version=5,
    config=AnnotateRoundConfig,
    inputs={
        "views": VIEWS,
        "rectified_views": RECTIFIED_VIEWS,
        "hand_boxes": HAND_BOXES,
        "crops": CROPS,
        "keypoints": KEYPOINTS,
        "triangulated": JOINTS,
        "joints": JOINTS,
        "earlier_joints": JOINTS,
        "corrections": CORRECTIONS,
    },
    outputs={"joints": JOINTS, "rounds": ROUNDS},
    run=run,
    shard="chunk",
    uses_gpu=True,
    externals=_externals,
    optional=frozenset({"corrections"}),
)
