"""Tables of errors with known figures."""

from collections.abc import Mapping

import numpy as np
import pyarrow as pa

from assemblyhands_core.data.evaluation_tables import EGO_ERRORS, ERRORS
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


def ego_errors_table(count: int = 8) -> pa.Table:
    """Crops of two cameras; errors grow by a millimetre a crop, the wrist's are 0, the last crop was not found."""
    error_mm = np.tile(np.arange(1.0, count + 1)[:, None], (1, 21))
    error_mm[:, 20] = 0.0
    error_mm[-1] = np.nan
    return EGO_ERRORS.build(
        {
            "sequence_id": ["s"] * count,
            "frame": np.arange(count),
            "hand": ["right", "left"] * (count // 2),
            "camera_id": ["a"] * (count // 2) + ["b"] * (count // 2),
            "labels": ["manual"] * count,
            "verb": ["screw"] * 2 + [""] * (count - 2),
            "error_mm": error_mm,
            "is_labelled": np.ones((count, 21), dtype=bool),
            "is_identity_right": np.arange(count) % 4 != 0,
            "border_px": np.linspace(0, 140, count),
        }
    )
