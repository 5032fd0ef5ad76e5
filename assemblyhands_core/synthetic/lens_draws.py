"""Random lenses that behave like those of the real rigs: drawn as smooth curves, then written as coefficients."""

import numpy as np
from jaxtyping import Float64

from assemblyhands_core.geometry.distortion import OpenCVLens, OVFishEye62

_FIELD_RADII = np.array([0.3, 0.6, 0.9])
_FIELD_MAGNIFICATION = np.array([0.9893, 0.9686, 0.9670])
_FIELD_SPREAD = np.array([1e-4, 3e-4, 7e-4])

_FIT_ANGLES = np.radians(np.linspace(0.5, 90.0, 180))
_MAX_TANGENTIAL = 1e-3


def draw_perspective_lens(rng: np.random.Generator) -> OpenCVLens:
    """Draw a lens with the barrel distortion of the exocentric cameras, k1 ≈ -0.13, k2 ≈ 0.12, |k3| ≲ 0.03.

    Drawn is how much the lens shrinks the image at three radii (a corner of the image lies at 0.89); the three radial
    coefficients follow.
    """
    shrink = _FIELD_MAGNIFICATION + np.clip(rng.normal(size=3), -1.5, 1.5) * _FIELD_SPREAD
    k1, k2, k3 = np.linalg.solve(_powers(_FIELD_RADII, 3), shrink - 1)
    p1, p2 = _tangential(rng, 3e-4)
    return OpenCVLens(k1=float(k1), k2=float(k2), k3=float(k3), p1=p1, p2=p2)


def draw_fisheye_lens(rng: np.random.Generator) -> OVFishEye62:
    """Draw a lens of the egocentric cameras, one-to-one over the whole image and up to 180°.

    The curve is r/θ = 1 + h θ² / sqrt(1 + (θ/w)⁴) + c (θ/90°)¹⁶: equidistant on the axis, stretched by about 28 % at
    75° and steeply more towards 90°, so that the corners of the image lie just in front of the lens. The last of the
    six radial coefficients is drawn, the others fit the curve up to 90°.
    """
    height, width, rim = rng.uniform((0.276, 1.085, 0.09), (0.288, 1.11, 0.12))
    k6 = rng.uniform(0.014, 0.020)
    curve = height * _FIT_ANGLES**2 / np.sqrt(1 + (_FIT_ANGLES / width) ** 4) + rim * (2 * _FIT_ANGLES / np.pi) ** 16
    powers = _powers(_FIT_ANGLES, 6)
    fitted = np.linalg.lstsq(powers[:, :5], curve - k6 * powers[:, 5], rcond=None)[0]
    k1, k2, k3, k4, k5 = (float(value) for value in fitted)
    p1, p2 = _tangential(rng, 6e-4)
    return OVFishEye62(k1=k1, k2=k2, k3=k3, k4=k4, k5=k5, k6=float(k6), p1=p1, p2=p2)


def _powers(radii: Float64[np.ndarray, " radius"], count: int) -> Float64[np.ndarray, "radius {count}"]:
    return np.asarray(radii[:, None] ** (2 * np.arange(1, count + 1)))


def _tangential(rng: np.random.Generator, spread: float) -> tuple[float, float]:
    p1, p2 = np.clip(rng.normal(0.0, spread, 2), -_MAX_TANGENTIAL, _MAX_TANGENTIAL)
    return float(p1), float(p2)
