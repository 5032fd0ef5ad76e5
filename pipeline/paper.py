"""What the paper reports (Ohkawa et al., CVPR 2023), to stand beside a run's own figures.

They are on recordings of real people. Figures on synthetic recordings are not comparable with them.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from pipeline.grids import Grid


@dataclass(frozen=True)
class PaperAnnotation:
    """A table of annotation methods: MPJPE in mm and PCK-AUC over 0-20 mm in percent, by method."""

    name: str
    figures: Mapping[str, tuple[float, float]]


ASSEMBLYHANDS: Final = PaperAnnotation(
    "Table 2: manually annotated frames of AssemblyHands, 8 cameras",
    {"2d_triangulation": (7.97, 63.8), "R1": (5.42, 79.2), "R2": (4.30, 83.1), "R3": (4.20, 83.4)},
)
DESKTOP_ACTIVITIES: Final = PaperAnnotation(
    "Table 3: Desktop Activities, another rig of 12 cameras",
    {"2d_triangulation": (49.21, 23.9), "R1": (21.20, 51.3), "R2": (14.57, 67.2), "R3": (13.38, 70.4)},
)

EGOCENTRIC_MM: Final = {
    ("Train-M", "Eval-M"): 24.38,
    ("Train-M", "Eval-A"): 28.58,
    ("Train-M", "Eval-M+A"): 28.35,
    ("Train-A", "Eval-M"): 25.18,
    ("Train-A", "Eval-A"): 22.29,
    ("Train-A", "Eval-M+A"): 22.45,
    ("Train-M+A", "Eval-M"): 23.46,
    ("Train-M+A", "Eval-A"): 21.84,
    ("Train-M+A", "Eval-M+A"): 21.92,
}
"""Table 4: SVEgoNet's wrist-relative MPJPE by what it was trained and evaluated on."""

VERBS: Final = Grid(
    "The paper's Table 5: verb accuracy (%), by MS-G3D trained on each source of poses",
    (
        "poses",
        "pick up",
        "put down",
        "position",
        "remove",
        "screw",
        "unscrew",
        "Avg. Verb Acc. (%)",
        "of the upper bound (%)",
        "pose error (mm)",
    ),
    (
        ("UmeTrack", "66.0", "41.5", "51.2", "29.2", "42.5", "59.6", "50.3", "83.8", "32.91"),
        ("SVEgoNet", "68.1", "47.7", "64.3", "27.4", "44.3", "63.7", "54.7", "91.1", "21.92"),
        ("AssemblyHands-A (upper bound)", "70.0", "57.4", "67.5", "36.4", "49.8", "64.1", "60.0", "100", "–"),
    ),
)


def annotation_of_rig(rig: str) -> PaperAnnotation:
    """Return the paper's table that is of the same kind of rig: the training one, unless it is the one beside it."""
    return DESKTOP_ACTIVITIES if rig == "desktop" else ASSEMBLYHANDS
