"""Which instants a network is trained on: a few, well apart, of many short takes on as many days."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from assemblyhands_core.hands.joints import HANDS
from assemblyhands_core.synthetic.crop_boxes import TIGHT_BOX, CropBox
from assemblyhands_core.synthetic.crop_mode import CropStudio, HandViews
from assemblyhands_core.synthetic.rig import RIGS
from assemblyhands_core.synthetic.take import Take
from assemblyhands_core.synthetic.toys import SetKind

NUM_INSTANTS: Final = 32
DURATION_S: Final = 24.0
"""A script takes half a second and 60 ms for every second of take, as long as drawing one hand in eight views does:
instants that lie 0.75 s apart, in which hands move by some centimetres, keep it below a quarter of the work."""

_STREAM: Final = 0x7A1E
# Recordings seed takes by a 32-bit checksum of their names and rigs by their day as eight digits: these are neither.
_FIRST_TAKE_SEED: Final = 2**32
_FIRST_DAY_SEED: Final = 10**9

FIRST_SUBJECT: Final = {"train": 2000, "val": 3000, "test": 4000}
"""Persons by split; no recording of the manifests has a participant of these numbers."""
NUM_SUBJECTS: Final = 1000


def training_subject(split: str, take: int) -> int:
    """Return who works in a take of a split.

    Raises:
        ValueError: There is no such split.
    """
    if split not in FIRST_SUBJECT:
        raise ValueError(f"There is no split {split} of takes for training: choose {', '.join(FIRST_SUBJECT)}.")
    return FIRST_SUBJECT[split] + take % NUM_SUBJECTS


@dataclass(frozen=True)
class TrainingTake:
    """A take of which some instants are used; cheap to make, to send to another process and to compare.

    Attributes:
        subject: Who works.
        take_seed: Of toy and script.
        day_seed: Of the rig's calibration and of the sensors.
        kind: Of things and rig.
        duration_s: Length of the take.
        times_s: The instants.
    """

    subject: int
    take_seed: int
    day_seed: int
    kind: SetKind
    duration_s: float
    times_s: tuple[float, ...]

    def open(self, camera_ids: Sequence[str] | None = None) -> CropStudio:
        """Write the take's script and furnish the studio.

        Args:
            camera_ids: Views, see `CropStudio.of`.
        """
        take = Take.from_seed(self.subject, self.take_seed, self.duration_s, self.kind)
        return CropStudio.of(take, RIGS[self.kind](self.day_seed), self.day_seed, camera_ids)

    def views(
        self, size_px: int = 128, box: CropBox = TIGHT_BOX, camera_ids: Sequence[str] | None = None
    ) -> Iterator[HandViews]:
        """Yield both hands of every instant, right hand first."""
        studio = self.open(camera_ids)
        for t_s in self.times_s:
            for hand in HANDS:
                yield studio.hand_views(t_s, hand, size_px, box)


def draw_training_take(
    subject: int,
    seed: int,
    kind: SetKind = "assembly",
    num_instants: int = NUM_INSTANTS,
    duration_s: float = DURATION_S,
) -> TrainingTake:
    """Draw a take, a day and instants of it that are at least half their mean distance apart.

    Args:
        subject: Who works.
        seed: Of everything else; no two seeds of a subject give the same take, nor one that is recorded.
        kind: Of things and rig.
        num_instants: How many.
        duration_s: Length of the take.
    """
    rng = np.random.default_rng([subject, seed, _STREAM, int(kind == "desktop")])
    step_s = duration_s / num_instants
    times = (np.arange(num_instants) + 0.25 + 0.5 * rng.random(num_instants)) * step_s
    return TrainingTake(
        subject=subject,
        take_seed=_FIRST_TAKE_SEED + int(rng.integers(2**40)),
        day_seed=_FIRST_DAY_SEED + int(rng.integers(10**9)),
        kind=kind,
        duration_s=duration_s,
        times_s=tuple(float(t) for t in np.round(times, 3)),
    )
