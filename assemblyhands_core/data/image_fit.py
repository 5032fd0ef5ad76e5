"""How the pixels of a video follow from those of the image that was calibrated, where their sizes differ.

Players, exporters and synchronisers rescale, letterbox and crop. A wrong guess bends every ray, so that the default
accepts only what sizes and picture prove together, and otherwise leaves the view out with a reason.
"""

from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np
from jaxtyping import UInt8

from assemblyhands_core.geometry.cameras import Camera

Picture = UInt8[np.ndarray, "height width 3"]  # RGB
FitChoice = Literal["auto", "same", "scaled", "letterboxed", "cropped"]
FitKind = Literal["same", "scaled", "letterboxed", "cropped", "unknown"]

_MAX_BLACK = 24.0  # of 255, mean over a row of its brightest channel; up to 18 was measured in bars of real videos
_MAX_BAR_ERROR_PX = 1.5  # bars are whole rows, and the one beside the picture may be blended with it
_MIN_BAR_PX = 3  # thinner black edges are left by encoders and say nothing


@dataclass(frozen=True, eq=False)
class ImageFit:
    """The verdict on one view.

    Attributes:
        kind: How video and calibrated image are related.
        camera: The camera of the video's pixels; None where that is unknown.
        reason: `image_size_mismatch` where `camera` is None.
        sentence: What a user should know, with sizes and, where something is wrong, the remedy.
        is_suspect: Whether a user should look at it although the view is used.
    """

    kind: FitKind
    camera: Camera | None
    reason: Literal["image_size_mismatch"] | None
    sentence: str
    is_suspect: bool = False


def fit_image(camera: Camera, picture: Picture, choice: FitChoice = "auto") -> ImageFit:
    """Decide how a video relates to the image its camera was calibrated for.

    `same`: equal sizes. `scaled`: the aspect ratios agree within half a pixel. `letterboxed`: scaled uniformly until it
    fits and the rest filled with black bars, which must really be there on both sides and as thick as they should be.
    `cropped`: the middle part, not scaled; never guessed.

    Args:
        camera: As calibrated.
        picture: One frame of the video, or the brightest value of each pixel over several.
        choice: `auto`, or what the user knows better; that is not checked against the picture.

    Returns:
        The camera of the video, by the pixel-centre rule u' = (u + 0.5) s - 0.5 + bar, with an explanation.

    Raises:
        ValueError: The choice is none of `FitChoice`, or impossible for these sizes.
    """
    if choice not in get_args(FitChoice):
        raise ValueError(f"image fit {choice!r} is unknown; use one of {', '.join(get_args(FitChoice))}")
    size = picture.shape[1], picture.shape[0]
    calibrated = camera.width_px, camera.height_px
    kind = _proven_kind(calibrated, picture) if choice == "auto" else choice
    sizes = f"{camera.camera_id}: the video is {size[0]}x{size[1]} px, the calibration {calibrated[0]}x{calibrated[1]}"
    told = "" if choice == "auto" else ", as you said"
    if kind == "same":
        if size != calibrated:
            raise ValueError(f"{sizes}, so the image fit cannot be 'same'; use scaled, letterboxed or cropped")
        return _same(camera, picture, sizes)
    if kind == "scaled":
        factors = f"{size[0] / calibrated[0]:.4f} x {size[1] / calibrated[1]:.4f}"
        return ImageFit(kind, camera.scaled(*size), None, f"{sizes}: scaled by {factors}{told}.")
    if kind == "letterboxed":
        return _letterboxed(camera, picture, f"{sizes}: letterboxed{told}")
    if kind == "cropped":
        return _cropped(camera, size, f"{sizes}: cropped{told}")
    return ImageFit("unknown", None, "image_size_mismatch", _remedy(calibrated, picture, sizes))


def _proven_kind(calibrated: tuple[int, int], picture: Picture) -> FitKind:
    height_px, width_px = picture.shape[:2]
    if (width_px, height_px) == calibrated:
        return "same"
    by_width, by_height = calibrated[1] * width_px / calibrated[0], calibrated[0] * height_px / calibrated[1]
    if min(abs(by_width - height_px), abs(by_height - width_px)) <= 0.5:
        return "scaled"
    axis, length_px = _content(calibrated, (width_px, height_px))
    expected = ((width_px, height_px)[axis] - length_px) / 2
    measured = _black_edges(picture, axis)
    is_there = min(measured) > 0 and max(abs(bar - expected) for bar in measured) <= _MAX_BAR_ERROR_PX
    return "letterboxed" if is_there else "unknown"


def _content(calibrated: tuple[int, int], size: tuple[int, int]) -> tuple[int, float]:
    """Axis (0 = x, 1 = y) along which a uniformly scaled image leaves bars, and its length between them in px."""
    scale = min(size[0] / calibrated[0], size[1] / calibrated[1])
    axis = 0 if size[0] / calibrated[0] > size[1] / calibrated[1] else 1
    return axis, calibrated[axis] * scale


def _black_edges(picture: Picture, axis: int) -> tuple[int, int]:
    """Number of black columns (axis 0) or rows (axis 1) at either edge; all of them in a black picture."""
    brightness = picture.max(axis=2).mean(axis=axis)
    lit = np.flatnonzero(brightness > _MAX_BLACK)
    return (int(lit[0]), len(brightness) - 1 - int(lit[-1])) if len(lit) else (len(brightness), len(brightness))


def _same(camera: Camera, picture: Picture, sizes: str) -> ImageFit:
    edges = [bar for axis in (0, 1) for bar in _black_edges(picture, axis)]
    if max(edges) < _MIN_BAR_PX:
        return ImageFit("same", camera, None, f"{sizes}: the same.")
    names = zip(("left", "right", "top", "bottom"), edges, strict=True)
    bars = ", ".join(f"{bar} px {name}" for name, bar in names if bar >= _MIN_BAR_PX)
    warning = (
        f"{sizes}: the same, but it has black edges ({bars}), as if edited since; check the calibration against it."
    )
    return ImageFit("same", camera, None, warning, is_suspect=True)


def _letterboxed(camera: Camera, picture: Picture, what: str) -> ImageFit:
    """Whole pixels between the bars: the whole calibrated image along their axis; across, it fills the video."""
    size = picture.shape[1], picture.shape[0]
    axis, exact_length_px = _content((camera.width_px, camera.height_px), size)
    length_px = round(exact_length_px)
    # An odd rest is split unevenly: look which side got more.
    before = (size[axis] - length_px) // 2
    if (size[axis] - length_px) % 2 and np.subtract(*_black_edges(picture, axis)) > 0:
        before += 1
    content = camera.scaled(*((length_px, size[1]) if axis == 0 else (size[0], length_px)))
    shift = (before, 0) if axis == 0 else (0, before)
    after = size[axis] - length_px - before
    sides = ("left and right", "top and bottom")[axis]
    sentence = f"{what}, scaled by {length_px / (camera.width_px, camera.height_px)[axis]:.4f} between black bars"
    return ImageFit(
        "letterboxed", _placed(content, size, shift), None, f"{sentence} of {before} and {after} px {sides}."
    )


def _cropped(camera: Camera, size: tuple[int, int], what: str) -> ImageFit:
    margin = camera.width_px - size[0], camera.height_px - size[1]
    if min(margin) < 0:
        raise ValueError(f"{what}, but a part cannot be larger than the whole; use scaled or letterboxed")
    shift = -margin[0] / 2, -margin[1] / 2
    sentence = f"{what}, {-shift[0]:g} px off at left and right and {-shift[1]:g} px at top and bottom."
    return ImageFit("cropped", _placed(camera, size, shift), None, sentence)


def _placed(camera: Camera, size: tuple[int, int], shift: tuple[float, float]) -> Camera:
    """The camera of a picture of another size, in which the image lies shifted by so many pixels."""
    cx_px, cy_px = camera.cx_px + shift[0], camera.cy_px + shift[1]
    return replace(camera, width_px=size[0], height_px=size[1], cx_px=cx_px, cy_px=cy_px)


def _remedy(calibrated: tuple[int, int], picture: Picture, sizes: str) -> str:
    height_px, width_px = picture.shape[:2]
    if (height_px, width_px) == calibrated:
        return f"{sizes}: it lies on its side; turn the video, or calibrate with pictures turned like it."
    axis, length_px = _content(calibrated, (width_px, height_px))
    expected = ((width_px, height_px)[axis] - length_px) / 2
    first, last = _black_edges(picture, axis)
    sides = ("left and right", "top and bottom")[axis]
    found = f"letterboxing would leave black bars of {expected:.1f} px {sides}, found are {first} and {last}"
    remedy = "say ingest.image_fit=scaled, letterboxed or cropped, or give the video as it was calibrated"
    return f"{sizes}: {found}; {remedy}."
