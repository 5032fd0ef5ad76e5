"""Tables of errors with known figures."""

from collections.abc import Mapping

import numpy as np
import pyarrow as pa

from assemblyhands_core.data.catalog import ERRORS
from assemblyhands_core.hands.joints import HANDS, NUM_JOINTS


def errors_table(
    errors_mm: Mapping[str, np.ndarray],
    *,
    sequence_id: str = "s",
    verbs: tuple[str, ...] = ("",),
    occlusion: tuple[float, ...] = (0.5,),
) -> pa.Table:
    """Return rows of every method; its errors are (frame, hand), equal for all joints, or (frame, hand, joint).

    Verbs and occlusion rates repeat from frame to frame.
    """
    tables = []
    for method, values in errors_mm.items():
        by_joint = np.broadcast_to(values[..., None], (*values.shape, NUM_JOINTS)) if values.ndim == 2 else values
        frames = np.repeat(np.arange(len(values)), len(HANDS))
        flat = by_joint.reshape(-1, NUM_JOINTS)
        columns = {
            "sequence_id": [sequence_id] * len(frames),
            "frame": frames,
            "hand": list(HANDS) * len(values),
            "method": [method] * len(frames),
            "error_mm": flat,
            "wrist_relative_error_mm": flat / 2,
            "is_labelled": np.ones_like(flat, dtype=bool),
            "is_own": np.ones(len(flat), dtype=bool),
            "verb": [verbs[frame % len(verbs)] for frame in frames],
            "occlusion_rate": [occlusion[frame % len(occlusion)] for frame in frames],
        }
        tables.append(ERRORS.build(columns))
    return pa.concat_tables(tables)
