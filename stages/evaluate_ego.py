"""Hold egocentric predictions against the labels of their crops: wrist-relative, as the paper does (Sec. 4)."""

import numpy as np
import pyarrow.compute as pc

from assemblyhands_core.data.arrays import to_numpy
from assemblyhands_core.data.catalog import MEMBERS
from assemblyhands_core.data.ego_tables import EGO_CROPS, EGO_HANDS
from assemblyhands_core.data.evaluation_tables import EGO_ERRORS
from assemblyhands_core.data.label_rows import MANUAL
from assemblyhands_core.data.tables import TableSpec
from assemblyhands_core.hands.joints import HANDS, NUM_JOINTS
from assemblyhands_core.hands.wrist import relative_to_wrist
from assemblyhands_core.metrics.keypoints import joint_errors_mm
from stages._contract import Context, Stage, StageConfig, Tables

AUTOMATIC = "automatic"


def run(config: StageConfig, inputs: Tables, context: Context) -> Tables:
    """Return a row for each crop of one sequence; predictions of all crops are given, in another order."""
    crops, hands = inputs["crops"], inputs["hands"]
    crops = crops.filter(pc.field("valid") & (pc.field("source") != ""))  # boxes may come without labels
    if not crops.num_rows:
        return {"errors": EGO_ERRORS.empty()}
    keys = [tuple(row.values()) for row in crops.select(EGO_CROPS.key).to_pylist()]
    place = {tuple(row.values()): i for i, row in enumerate(hands.select(EGO_CROPS.key).to_pylist())}
    found = hands.take([place[key] for key in keys])
    own = [HANDS.index(hand) for hand in crops["hand"].to_pylist()]
    true = to_numpy(crops["joints_camera_mm"]).reshape(-1, len(HANDS), NUM_JOINTS, 3)[range(len(own)), own]
    is_labelled = to_numpy(crops["is_labelled"]).reshape(-1, len(HANDS), NUM_JOINTS).astype(bool)[range(len(own)), own]
    predicted = to_numpy(found["joints_camera_mm"]).reshape(-1, NUM_JOINTS, 3).astype(np.float64)
    predicted[~to_numpy(found["valid"]).astype(bool)] = np.nan
    error_mm = joint_errors_mm(relative_to_wrist(predicted), relative_to_wrist(true.astype(np.float64)), is_labelled)
    columns = {
        **{name: crops[name] for name in EGO_CROPS.key},
        "labels": [MANUAL if source == MANUAL else AUTOMATIC for source in crops["source"].to_pylist()],
        "verb": crops["verb"],
        "error_mm": error_mm,
        "is_labelled": is_labelled,
        "is_identity_right": to_numpy(found["identity"]) == to_numpy(crops["identity"]),
        "border_px": crops["border_px"],
    }
    return {"errors": EGO_ERRORS.build(columns)}


def _stage(**more: TableSpec) -> Stage[StageConfig]:
    return Stage(
        name="evaluate_ego",
        version=2,
        config=StageConfig,
        inputs={"crops": EGO_CROPS, "hands": EGO_HANDS, **more},
        outputs={"errors": EGO_ERRORS},
        run=run,
        shard="sequence",
    )


STAGE = _stage()
OF_JUDGED = _stage(judged=MEMBERS)
"""The same for the sequences alone that a network trained in this run is judged by."""
