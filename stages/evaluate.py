"""Hold 3D joints against the simulator's truth: the one stage after the studio's own that may read it.

It is used once for each round, so that another round leaves the evaluation of the earlier ones as it is; methods are
compared from the errors of every joint, which it keeps (`metrics.comparison`).
"""

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc
from pydantic import Field, model_validator

from assemblyhands_core.data.arrays import to_numpy
from assemblyhands_core.data.catalog import CHUNKS, JOINTS, SOURCES
from assemblyhands_core.data.evaluation_tables import ERRORS, EVALUATION
from assemblyhands_core.data.keypoint_rows import rows_of_hands
from assemblyhands_core.data.label_rows import MANUAL
from assemblyhands_core.data.round_outcomes import KEPT
from assemblyhands_core.data.rounds import SMOOTHED, TRIANGULATED, TRUE_ROUND, joints_or_nan
from assemblyhands_core.hands.joints import NUM_JOINTS
from assemblyhands_core.hands.wrist import relative_to_wrist
from assemblyhands_core.metrics.annotation import Resampling, evaluate_annotation
from assemblyhands_core.metrics.keypoints import joint_errors_mm
from stages._contract import Context, Stage, StageConfig, Tables
from stages._truth import read_truth

UPPER_BOUND = "true crops and root"
"""What the tables call a round that started from the truth."""


class EvaluateConfig(StageConfig):
    """Parameters of the evaluation."""

    low_occlusion: float = Field(gt=0, lt=1)
    high_occlusion: float = Field(gt=0, lt=1)
    block_frames: int = Field(ge=1)
    num_resamples: int = Field(ge=100)
    seed: int = Field(ge=0)

    @property
    def resampling(self) -> Resampling:
        """Return how intervals are drawn."""
        return Resampling(self.block_frames, self.num_resamples, self.seed)

    @model_validator(mode="after")
    def _bounds_are_in_order(self) -> "EvaluateConfig":
        if self.low_occlusion >= self.high_occlusion:
            raise ValueError(f"low_occlusion={self.low_occlusion} has to be below high_occlusion={self.high_occlusion}")
        return self


def run(config: EvaluateConfig, inputs: Tables, context: Context) -> Tables:
    """Evaluate one sequence."""
    truth = _of_chunks(_read_truth(inputs["truth"], context.sequence_id), inputs["chunks"])
    joints = inputs["joints"]
    joints = joints.append_column("method", _methods(joints))
    by_method = [joints.filter(pc.equal(joints["method"], name)) for name in pc.unique(joints["method"])]
    errors = pa.concat_tables([ERRORS.empty(), *(_errors(truth, of_method) for of_method in by_method)])
    cells = evaluate_annotation(errors, (config.low_occlusion, config.high_occlusion), config.resampling)
    rows = [{"sequence_id": context.sequence_id, **cell._asdict()} for cell in cells]
    return {"errors": errors, "metrics": EVALUATION.from_rows(rows)}


def _read_truth(files: pa.Table, sequence_id: str) -> pa.Table:
    """Return a row for each hand at each true instant: its joints and what is being done."""
    joints, instants = read_truth(files, sequence_id)
    place = pc.index_in(joints["frame"], instants["frame"])
    if place.null_count:
        raise ValueError(
            f"sequence {sequence_id}: {place.null_count} true hands have no true instant; record the sequence again."
        )
    for name in ("verb", "exo_occlusion_rate"):
        joints = joints.append_column(name, instants[name].take(place))
    return joints


def _methods(joints: pa.Table) -> pa.Array:
    """Return what the paper's tables call each row: R1, R2, R3, and before them the way in which it was made."""
    rounds, sources = joints["round"].to_pylist(), joints["source"].to_pylist()
    return pa.array([_method(*row) for row in zip(rounds, sources, strict=True)], pa.string())


def _method(number: int, source: str) -> str:
    source = TRIANGULATED if source == MANUAL else source  # people corrected its 2D keypoints
    name = {0: source, TRUE_ROUND + 1: UPPER_BOUND}.get(number, f"R{number}")
    return f"{name}, {SMOOTHED}" if number and source == SMOOTHED else name


def _of_chunks(truth: pa.Table, chunks: pa.Table) -> pa.Table:
    """Return the truth about the frames that were looked at: a run may be told to read the first ones alone."""
    ends = (c["first_frame"] + c["num_frames"] for c in chunks.to_pylist())
    return truth.filter(pc.field("frame") < max(ends, default=0))


def _errors(truth: pa.Table, joints: pa.Table) -> pa.Table:
    """Return a method's errors at every true hand; a hand without a row is missing altogether."""
    place = _places(truth, joints)
    is_true = pc.equal(joints["source"], f"{KEPT}{TRUE_ROUND}").to_numpy(zero_copy_only=False)  # that is no estimate
    predicted, is_own = np.full((truth.num_rows, NUM_JOINTS, 3), np.nan), np.zeros(truth.num_rows, dtype=bool)
    predicted[place] = np.where(is_true[:, None, None], np.nan, joints_or_nan(joints))
    is_own[place] = ~pc.starts_with(joints["source"], KEPT).to_numpy(zero_copy_only=False)
    true = to_numpy(truth["joints_world_mm"]).reshape(-1, NUM_JOINTS, 3).astype(np.float64)
    is_labelled = np.asarray(np.isfinite(true).all(axis=-1))
    return ERRORS.build(
        {
            **{name: truth[name] for name in ("sequence_id", "frame", "hand", "verb")},
            "method": [joints["method"][0].as_py()] * truth.num_rows,
            "error_mm": joint_errors_mm(predicted, true, is_labelled),
            "wrist_relative_error_mm": joint_errors_mm(
                relative_to_wrist(predicted), relative_to_wrist(true), is_labelled
            ),
            "is_labelled": is_labelled,
            "is_own": is_own,
            "occlusion_rate": truth["exo_occlusion_rate"],
        }
    )


def _places(truth: pa.Table, joints: pa.Table) -> npt.NDArray[np.int64]:
    """Return which true hand each row of joints is about."""
    place = rows_of_hands(joints, truth)
    if unknown := int(np.sum(place < 0)):
        frame, hand = (joints[name][int(np.argmin(place))].as_py() for name in ("frame", "hand"))
        raise ValueError(
            f"frame {frame}: the {hand} hand has joints but no truth, like {unknown} rows in all; the truth counts the "
            "frames of the 30 Hz videos: annotate these, or give the truth of this recording."
        )
    return place


STAGE = Stage(
    name="evaluate",
    version=2,
    config=EvaluateConfig,
    inputs={"chunks": CHUNKS, "truth": SOURCES, "joints": JOINTS},
    outputs={"errors": ERRORS, "metrics": EVALUATION},
    run=run,
    shard="sequence",
)
