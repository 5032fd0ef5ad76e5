"""What every stage with a detector is told: which one, and the options of each."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar, Final, Self

from pydantic import JsonValue, ValidationInfo, field_serializer, field_validator

from assemblyhands_core.detectors.options import options_for_sequence
from assemblyhands_core.detectors.registry import fingerprint
from stages._contract import StageConfig

AUTO: Final = "auto"
"""The keypoints that come with a recording; where none do, the detector that suits its pictures."""


class DetectorConfig(StageConfig):
    """Base of the parameters of stages that run a detector.

    Attributes:
        options: detector → its options, so that ``detect_hands.options.precomputed.root=PATH`` can be given.
        detector: the one that runs, or ``auto``.
        keypoints_file: what the file of this stage is called where 2D keypoints come with a recording.
    """

    keypoints_file: ClassVar[str]
    options: Mapping[str, Mapping[str, JsonValue]]
    detector: str

    def detector_options(self, sequence_id: str) -> dict[str, Any]:
        """Return the options of the detector that runs, for one sequence."""
        return options_for_sequence(self.options[self.detector], sequence_id)

    def resolved(self, keypoints: Path | None, detector: str) -> Self:
        """Return the configuration with the detector that runs for a recording.

        Args:
            keypoints: Folder of the 2D keypoints that come with the recording; None where a detector has to find them.
            detector: The one that suits its pictures.
        """
        if self.detector != AUTO:
            return self
        if keypoints is None:
            return self.model_copy(update={"detector": detector})
        options = {**self.options, "precomputed": {"root": str(keypoints / self.keypoints_file)}}
        return self.model_copy(update={"detector": "precomputed", "options": options})

    @field_validator("detector")
    @classmethod
    def _is_known(cls, detector: str, info: ValidationInfo) -> str:
        known = info.data.get("options", {detector: {}})
        if detector not in (AUTO, *known):
            raise ValueError(f"choose one of {', '.join([AUTO, *known])}")
        return detector

    @field_serializer("options")
    def _of_the_one_that_runs(self, options: Mapping[str, Mapping[str, JsonValue]]) -> dict[str, Any]:
        """Leave out what cannot change a result: an unused detector's option must not make anything run again."""
        return {name: dict(found) for name, found in options.items() if name == self.detector}


def detector_externals(config: DetectorConfig, sequence_id: str) -> Mapping[str, str]:
    """Return what the detector that runs depends on beyond its options: package version, weights, files."""
    return fingerprint(config.detector, config.detector_options(sequence_id))
