"""Hold egocentric predictions against the labels of their crops: wrist-relative, as the paper does (Sec. 4)."""

import numpy as np
import pyarrow as pa
from pydantic import Field

from assemblyhands_core.data.arrays import to_numpy
from assemblyhands_core.data.catalog import EGO_CROPS, EGO_ERRORS, EGO_HANDS, EVALUATION
from assemblyhands_core.hands.joints import HANDS, NUM_JOINTS
from assemblyhands_core.metrics.annotation import Resampling
from assemblyhands_core.metrics.egocentric import evaluate_egocentric
from assemblyhands_core.metrics.keypoints import joint_errors_mm, relative_to_wrist
from stages._contract import Context, Stage, StageConfig, Tables

MANUAL, AUTOMATIC = "manual", "automatic"


class EvaluateEgoConfig(StageConfig):
    """Parameters of the evaluation."""

    block_frames: int = Field(ge=1)
    num_resamples: int = Field(ge=100)
    seed: int = Field(ge=0)


def run(config: EvaluateEgoConfig, inputs: Tables, context: Context) -> Tables:
    """Evaluate one sequence by both kinds of labels."""
    errors = pa.concat_tables(
        [
            _errors(inputs["manual_crops"], inputs["manual_hands"], MANUAL),
            _errors(inputs["automatic_crops"], inputs["automatic_hands"], AUTOMATIC),
        ]
    )
    cells = evaluate_egocentric(errors, Resampling(config.block_frames, config.num_resamples, config.seed))
    rows = [{"sequence_id": context.sequence_id, **cell._asdict()} for cell in cells]
    return {"errors": errors, "metrics": EVALUATION.from_rows(rows)}


def _errors(crops: pa.Table, hands: pa.Table, labels: str) -> pa.Table:
    """Return a row for each crop that there is; predictions of all crops are given, in another order."""
    crops = crops.filter(crops["valid"])
    if not crops.num_rows:
        return EGO_ERRORS.empty()
    keys = [tuple(row.values()) for row in crops.select(EGO_CROPS.key).to_pylist()]
    place = {tuple(row.values()): i for i, row in enumerate(hands.select(EGO_CROPS.key).to_pylist())}
    found = hands.take([place[key] for key in keys])
    own = [HANDS.index(hand) for hand in crops["hand"].to_pylist()]
    true = to_numpy(crops["joints_camera_mm"]).reshape(-1, len(HANDS), NUM_JOINTS, 3)[range(len(own)), own]
    is_labelled = to_numpy(crops["is_labelled"]).reshape(-1, len(HANDS), NUM_JOINTS).astype(bool)[range(len(own)), own]
    predicted = to_numpy(found["joints_camera_mm"]).reshape(-1, NUM_JOINTS, 3).astype(np.float64)
    predicted[~to_numpy(found["valid"]).astype(bool)] = np.nan
    error_mm = joint_errors_mm(relative_to_wrist(predicted), relative_to_wrist(true.astype(np.float64)), is_labelled)
    return EGO_ERRORS.build(
        {
            **{name: crops[name] for name in EGO_CROPS.key},
            "labels": [labels] * crops.num_rows,
            "error_mm": error_mm,
            "is_labelled": is_labelled,
            "is_identity_right": to_numpy(found["identity"]) == to_numpy(crops["identity"]),
            "border_px": crops["border_px"],
        }
    )


STAGE = Stage(
    name="evaluate_ego",
    version=1,
    config=EvaluateEgoConfig,
    inputs={
        "manual_crops": EGO_CROPS,
        "manual_hands": EGO_HANDS,
        "automatic_crops": EGO_CROPS,
        "automatic_hands": EGO_HANDS,
    },
    outputs={"errors": EGO_ERRORS, "metrics": EVALUATION},
    run=run,
    shard="sequence",
)
