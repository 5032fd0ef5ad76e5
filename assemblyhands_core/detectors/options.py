"""A detector's options as a configuration holds them: by detector, with the sequence's name filled in."""

from collections.abc import Mapping
from typing import Any

from assemblyhands_core.detectors.base import DetectorError

_PLACEHOLDER = "{sequence_id}"


def detector_options(options: Mapping[str, Mapping[str, Any]], detector: str, sequence_id: str) -> dict[str, Any]:
    """Return the options of one detector; ``{sequence_id}`` in a text becomes the sequence's name.

    Raises:
        DetectorError: if there are no options for that detector.
    """
    if detector not in options:
        raise DetectorError(f"There is no detector '{detector}': choose one of {', '.join(options)}.")
    return {
        name: value.replace(_PLACEHOLDER, sequence_id) if isinstance(value, str) else value
        for name, value in options[detector].items()
    }
