"""A detector's options as a configuration holds them, with the sequence's name filled in."""

from collections.abc import Mapping
from typing import Any

_PLACEHOLDER = "{sequence_id}"


def options_for_sequence(options: Mapping[str, Any], sequence_id: str) -> dict[str, Any]:
    """Return a detector's options; ``{sequence_id}`` in a text becomes the sequence's name."""
    return {
        name: value.replace(_PLACEHOLDER, sequence_id) if isinstance(value, str) else value
        for name, value in options.items()
    }
