"""Why a value is missing: the words of the `reason` and `status` columns that geometry can give."""

from enum import StrEnum


class Reason(StrEnum):
    """Outcome of a triangulation; compares equal to its string."""

    OK = "ok"
    TOO_FEW_VIEWS = "too_few_views"
    """Fewer usable views than needed: missing pixel, confidence 0, or a pixel outside the valid field of its lens."""
    HIGH_REPROJECTION = "high_reprojection"
    """The views do not agree on one point within the allowed distance."""
    BEHIND_CAMERA = "behind_camera"
    """The rays meet only behind cameras."""
    DEGENERATE = "degenerate"
    """The rays are nearly parallel, so their distance is unknown."""
