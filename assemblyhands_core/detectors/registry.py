"""The detectors by name; each is imported only when it is asked for."""

import importlib
from collections.abc import Mapping
from types import ModuleType
from typing import Any, Final, Literal, cast

from assemblyhands_core.detectors.base import BodyDetector, DetectorError, HandDetector

_Part = Literal["Body", "Hands"]

# Module name and class prefix. A module offers `<prefix>Body`, `<prefix>Hands` and `fingerprint(options)`.
_DETECTORS: Final = {"learned": "Learned", "mediapipe": "Mediapipe", "precomputed": "Precomputed", "rtmlib": "Rtmlib"}

DETECTOR_NAMES: Final = tuple(_DETECTORS)


def create_body_detector(name: str, **options: Any) -> BodyDetector:
    """Return the body detector of that name.

    Raises:
        DetectorError: unknown name, unknown option, or its package is not installed.
    """
    return cast(BodyDetector, _create(name, "Body", options))


def create_hand_detector(name: str, **options: Any) -> HandDetector:
    """Return the hand detector of that name.

    Raises:
        DetectorError: unknown name, unknown option, or its package is not installed.
    """
    return cast(HandDetector, _create(name, "Hands", options))


def fingerprint(name: str, options: Mapping[str, Any]) -> dict[str, str]:
    """Return what a detector's results depend on besides its options: package version, digests of weights or files.

    Raises:
        DetectorError: unknown name, its package is not installed, or a file it reads is absent.
    """
    return cast(dict[str, str], _module(name).fingerprint(options))


def _create(name: str, part: _Part, options: Mapping[str, Any]) -> object:
    constructor = getattr(_module(name), _DETECTORS[name] + part)
    try:
        return constructor(**options)
    except TypeError as error:
        if "keyword argument" not in str(error) and "positional argument" not in str(error):
            raise
        raise DetectorError(f"Detector '{name}' was given options {sorted(options)}: {error}") from error


def _module(name: str) -> ModuleType:
    if name not in _DETECTORS:
        raise DetectorError(f"There is no detector '{name}': choose one of {', '.join(DETECTOR_NAMES)}.")
    return importlib.import_module(f"assemblyhands_core.detectors.{name}")
