"""Lens models: rays in the camera frame to normalised image coordinates, and exactly back.

A normalised coordinate times the focal length plus the principal point is a pixel. Every model is defined on its
valid field only, where it is one-to-one: in front of the camera (pinhole, OpenCV), at most 180° off the axis (fisheye),
and in short up to the turning point of its radial polynomial. Outside, both directions give NaN, because there a pixel
has no single ray.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt
from jaxtyping import Float, Float64, Real

from assemblyhands_core.geometry.root_finding import first_positive_root, newton, polynomial, slope, solve_2x2

COEFFICIENT_NAMES = ("k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2", "p3", "p4")
"""The order in which every lens stores its coefficients."""

Plane = Float64[np.ndarray, "point 2"]

_NUM_TABLE_SAMPLES = 1024
_MAX_TAN = 1e3  # 89.94° off the axis: where the field of a perspective lens without turning point ends


@runtime_checkable
class Lens(Protocol):
    """What a camera needs to know about its lens."""

    model: ClassVar[str]

    def distort(self, rays: Real[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 2"]:
        """Map rays or points in the camera frame to normalised image coordinates."""
        ...

    def undistort(self, normalised: Real[np.ndarray, "*batch 2"]) -> Float[np.ndarray, "*batch 3"]:
        """Map normalised image coordinates to unit rays in the camera frame."""
        ...

    def coefficients(self) -> Float64[np.ndarray, "10"]:
        """Return the coefficients in the order k1..k6, p1..p4."""
        ...


@dataclass(frozen=True)
class Pinhole:
    """The lens without distortion."""

    model: ClassVar[str] = "Pinhole"

    def distort(self, rays: Real[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 2"]:
        """Divide by depth; NaN at and behind the camera plane."""
        points, dtype = _as_double(rays)
        return _perspective(points).astype(dtype, copy=False)

    def undistort(self, normalised: Real[np.ndarray, "*batch 2"]) -> Float[np.ndarray, "*batch 3"]:
        """Return the unit rays of normalised coordinates."""
        plane, dtype = _as_double(normalised)
        return _unit_rays(plane).astype(dtype, copy=False)

    def coefficients(self) -> Float64[np.ndarray, "10"]:
        """Return ten zeros."""
        return np.zeros(len(COEFFICIENT_NAMES))


@dataclass(frozen=True)
class OpenCVLens:
    """The perspective lens of OpenCV: radial (rational when k4..k6 are given) plus tangential (formats 1.5)."""

    k1: float = 0.0
    k2: float = 0.0
    k3: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    k4: float = 0.0
    k5: float = 0.0
    k6: float = 0.0
    model: ClassVar[str] = "OpenCV"

    def distort(self, rays: Real[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 2"]:
        """Map rays to normalised coordinates; NaN behind the camera plane and beyond the turning point."""
        points, dtype = _as_double(rays)
        plane = _perspective(points)
        squared = _squared_norm(plane)
        squared = np.where(squared <= self._max_radius**2, squared, np.nan)
        radial = np.asarray(polynomial(self._numerator, squared) / polynomial(self._denominator, squared))
        return self._map(plane, radial).astype(dtype, copy=False)

    def undistort(self, normalised: Real[np.ndarray, "*batch 2"]) -> Float[np.ndarray, "*batch 3"]:
        """Map normalised coordinates to unit rays by Newton's method in the plane; NaN outside the valid field."""
        target, dtype = _as_double(normalised)
        flat = target.reshape(-1, 2)
        plane = newton(self._newton_step, flat, self._radial_start(flat))
        plane[~(_squared_norm(plane) <= self._max_radius**2)] = np.nan
        return _unit_rays(plane).reshape(*target.shape[:-1], 3).astype(dtype, copy=False)

    def coefficients(self) -> Float64[np.ndarray, "10"]:
        """Return k1..k6, p1, p2, 0, 0."""
        return _stored(self)

    @cached_property
    def _numerator(self) -> Float64[np.ndarray, "4"]:
        return np.array([1.0, self.k1, self.k2, self.k3])

    @cached_property
    def _denominator(self) -> Float64[np.ndarray, "4"]:
        return np.array([1.0, self.k4, self.k5, self.k6])

    @cached_property
    def _max_radius(self) -> float:
        """The radius up to which the Jacobian is positive definite, so that the lens is one-to-one.

        Its eigenvalues are at least those of the radial part, d(r·N/D)/dr and N/D, less 6 |p| r for the tangential one.
        """
        r = np.polynomial.Polynomial([0.0, 1.0])
        n, d = (np.polynomial.Polynomial(part)(r**2) for part in (self._numerator, self._denominator))
        tangential = 6 * float(np.hypot(self.p1, self.p2)) * r
        along = n * d + r * (n.deriv() * d - n * d.deriv()) - tangential * d * d
        across = n - tangential * d
        return min(_MAX_TAN, *(first_positive_root(condition.coef) for condition in (along, across, d)))

    @cached_property
    def _radius_table(self) -> tuple[Float64[np.ndarray, " sample"], Float64[np.ndarray, " sample"]]:
        angles = np.linspace(0.0, np.arctan(self._max_radius), _NUM_TABLE_SAMPLES)
        radii = np.tan(angles)
        return radii * self._radial(radii**2)[0], radii

    def _radial(
        self, s: Float64[np.ndarray, "*batch"]
    ) -> tuple[Float64[np.ndarray, "*batch"], Float64[np.ndarray, "*batch"]]:
        """Return the radial factor and its derivative by s = r²."""
        numerator, denominator = polynomial(self._numerator, s), polynomial(self._denominator, s)
        factor = numerator / denominator
        return factor, (slope(self._numerator, s) - factor * slope(self._denominator, s)) / denominator

    def _map(
        self, plane: Float64[np.ndarray, "*batch 2"], radial: Float64[np.ndarray, "*batch"]
    ) -> Float64[np.ndarray, "*batch 2"]:
        """Apply the lens, given the radial factor at the points."""
        a, b = plane[..., 0], plane[..., 1]
        s, ab = a * a + b * b, a * b
        return np.stack(
            (
                a * radial + 2 * self.p1 * ab + self.p2 * (s + 2 * a * a),
                b * radial + self.p1 * (s + 2 * b * b) + 2 * self.p2 * ab,
            ),
            axis=-1,
        )

    def _newton_step(self, plane: Plane, target: Plane) -> tuple[Plane, Plane]:
        a, b = plane[:, 0], plane[:, 1]
        radial, change = self._radial(a * a + b * b)
        error = self._map(plane, radial) - target
        cross = 2 * change * a * b + 2 * self.p1 * a + 2 * self.p2 * b
        du_da = radial + 2 * change * a * a + 2 * self.p1 * b + 6 * self.p2 * a
        dv_db = radial + 2 * change * b * b + 6 * self.p1 * b + 2 * self.p2 * a
        return error, solve_2x2(du_da, cross, cross, dv_db, error)

    def _radial_start(self, target: Plane) -> Plane:
        """Invert the radial part alone from a table: close enough for Newton never to jump over the turning point."""
        distorted_radius = np.sqrt(_squared_norm(target))
        distorted, radii = self._radius_table
        # The tangential terms may reach a little beyond the radial table: start those at its edge.
        near_edge = distorted_radius <= distorted[-1] * 1.05
        radius = np.where(near_edge, np.interp(distorted_radius, distorted, radii), np.nan)
        return target * (radius / np.where(distorted_radius > 0, distorted_radius, 1.0))[:, None]


@dataclass(frozen=True)
class OVFishEye62:
    """The equidistant fisheye of the ego cameras: six even radial powers, then two tangential terms (formats 1.6).

    The tangential terms act on the already radially distorted point and p1, p2 have the opposite roles of OpenCV's.
    """

    k1: float = 0.0
    k2: float = 0.0
    k3: float = 0.0
    k4: float = 0.0
    k5: float = 0.0
    k6: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    model: ClassVar[str] = "OVFishEye62"

    def distort(self, rays: Real[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 2"]:
        """Map rays to normalised coordinates; NaN beyond the turning point and on the axis behind the camera."""
        points, dtype = _as_double(rays)
        off_axis = np.hypot(points[..., 0], points[..., 1])
        angle = np.arctan2(off_axis, points[..., 2])
        angle = np.where((angle <= self._max_angle) & ((off_axis > 0) | (points[..., 2] > 0)), angle, np.nan)
        scale = angle * polynomial(self._radial, np.asarray(angle * angle)) / np.where(off_axis > 0, off_axis, 1.0)
        return self._add_tangential(points[..., :2] * scale[..., None]).astype(dtype, copy=False)

    def undistort(self, normalised: Real[np.ndarray, "*batch 2"]) -> Float[np.ndarray, "*batch 3"]:
        """Map normalised coordinates to unit rays: Newton on the tangential map, then on the radial polynomial."""
        target, dtype = _as_double(normalised)
        flat = target.reshape(-1, 2)
        radial_point = newton(self._tangential_step, flat, flat.copy())
        radius = np.sqrt(_squared_norm(radial_point))
        angle = self._angle(radius)
        direction = radial_point / np.where(radius > 0, radius, 1.0)[:, None]
        rays = np.concatenate((direction * np.sin(angle)[:, None], np.cos(angle)[:, None]), axis=-1)
        return rays.reshape(*target.shape[:-1], 3).astype(dtype, copy=False)

    def coefficients(self) -> Float64[np.ndarray, "10"]:
        """Return k1..k6, p1, p2, 0, 0."""
        return _stored(self)

    @cached_property
    def _radial(self) -> Float64[np.ndarray, "7"]:
        return np.array([1.0, self.k1, self.k2, self.k3, self.k4, self.k5, self.k6])

    @cached_property
    def _max_angle(self) -> float:
        """The angle up to which the lens is one-to-one, at most π.

        The radial part θ·poly(θ²) has to grow, and the Jacobian of the tangential part, whose eigenvalues are at least
        1 - 6 |p| R, has to be positive definite.
        """
        angle = np.polynomial.Polynomial([0.0, 1.0])
        radial = angle * np.polynomial.Polynomial(self._radial)(angle**2)
        tangential = 1 - 6 * float(np.hypot(self.p1, self.p2)) * radial
        return min(np.pi, first_positive_root(radial.deriv().coef), first_positive_root(tangential.coef))

    @cached_property
    def _angle_table(self) -> tuple[Float64[np.ndarray, " sample"], Float64[np.ndarray, " sample"]]:
        angles = np.linspace(0.0, self._max_angle, _NUM_TABLE_SAMPLES)
        return angles * polynomial(self._radial, angles**2), angles

    def _angle(self, radius: Float64[np.ndarray, " point"]) -> Float64[np.ndarray, " point"]:
        """Invert θ·poly(θ²) = radius; NaN beyond the largest angle of the field."""
        distorted, angles = self._angle_table
        start = np.interp(radius, distorted, angles, right=np.nan)
        return newton(self._angle_step, radius[:, None], start[:, None])[:, 0]

    def _angle_step(
        self, angle: Float64[np.ndarray, "point 1"], radius: Float64[np.ndarray, "point 1"]
    ) -> tuple[Float64[np.ndarray, "point 1"], Float64[np.ndarray, "point 1"]]:
        s = angle * angle
        factor = polynomial(self._radial, s)
        error = angle * factor - radius
        derivative = factor + 2 * s * slope(self._radial, s)
        return error, error / np.where(derivative > 0, derivative, np.nan)

    def _add_tangential(self, point: Float64[np.ndarray, "*batch 2"]) -> Float64[np.ndarray, "*batch 2"]:
        a, b = point[..., 0], point[..., 1]
        s, ab = a * a + b * b, a * b
        return np.stack(
            (
                a + self.p1 * (s + 2 * a * a) + 2 * self.p2 * ab,
                b + self.p2 * (s + 2 * b * b) + 2 * self.p1 * ab,
            ),
            axis=-1,
        )

    def _tangential_step(self, point: Plane, target: Plane) -> tuple[Plane, Plane]:
        a, b = point[:, 0], point[:, 1]
        error = self._add_tangential(point) - target
        cross = 2 * self.p1 * b + 2 * self.p2 * a
        du_da = 1 + 6 * self.p1 * a + 2 * self.p2 * b
        dv_db = 1 + 6 * self.p2 * b + 2 * self.p1 * a
        return error, solve_2x2(du_da, cross, cross, dv_db, error)


def lens_from_coefficients(model: str, coefficients: Mapping[str, float] | npt.ArrayLike) -> Lens:
    """Build a lens from its model name and stored coefficients.

    Args:
        model: "Pinhole", "OpenCV" or "OVFishEye62".
        coefficients: By name (missing ones are 0), or ten in the order k1..k6, p1..p4.

    Raises:
        ValueError: Unknown model, or a coefficient that this model does not have is not zero.
    """
    if model not in _LENSES:
        raise ValueError(f"Distortion model {model!r} is not supported: use one of {', '.join(_LENSES)}.")
    values = _named_coefficients(coefficients)
    known = {name: values.pop(name) for name in _LENSES[model].__dataclass_fields__ if name in values}
    if any(values.values()):
        unused = ", ".join(f"{name}={value}" for name, value in values.items() if value)
        raise ValueError(f"Lens model {model} has no {unused}: set it to 0 or choose the model that was calibrated.")
    lens: Lens = _LENSES[model](**known)
    return lens


_LENSES: dict[str, Any] = {lens.model: lens for lens in (Pinhole, OpenCVLens, OVFishEye62)}


def _named_coefficients(coefficients: Mapping[str, float] | npt.ArrayLike) -> dict[str, float]:
    if isinstance(coefficients, Mapping):
        named = {name: float(value) for name, value in coefficients.items()}
    else:
        named = dict(zip(COEFFICIENT_NAMES, np.asarray(coefficients, dtype=float).tolist(), strict=True))
    if not set(named) <= set(COEFFICIENT_NAMES) or not np.isfinite(list(named.values())).all():
        raise ValueError(f"Lens coefficients {named} are wrong: give finite numbers named {COEFFICIENT_NAMES}.")
    return named


def _stored(lens: OpenCVLens | OVFishEye62) -> Float64[np.ndarray, "10"]:
    return np.array([getattr(lens, name, 0.0) for name in COEFFICIENT_NAMES])


def _as_double(values: Real[np.ndarray, "*shape"]) -> tuple[Float64[np.ndarray, "*shape"], np.dtype[Any]]:
    """Return float64 values to compute with and the type to answer in."""
    values = np.asarray(values)
    dtype = values.dtype if values.dtype == np.float32 else np.dtype(np.float64)
    return values.astype(np.float64, copy=False), dtype


def _perspective(points: Float64[np.ndarray, "*batch 3"]) -> Float64[np.ndarray, "*batch 2"]:
    depth = points[..., 2:]
    return points[..., :2] / np.where(depth > 0, depth, np.nan)


def _unit_rays(plane: Float64[np.ndarray, "*batch 2"]) -> Float64[np.ndarray, "*batch 3"]:
    rays = np.concatenate((plane, np.ones_like(plane[..., :1])), axis=-1)
    return np.asarray(rays / np.linalg.norm(rays, axis=-1, keepdims=True))


def _squared_norm(plane: Float64[np.ndarray, "*batch 2"]) -> Float64[np.ndarray, "*batch"]:
    return np.asarray(plane[..., 0] ** 2 + plane[..., 1] ** 2)
