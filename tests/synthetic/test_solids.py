"""Solids: closed meshes and exact distances."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from assemblyhands_core.synthetic.solids import Box, Solid, cylinder, tapered_capsule

SOLIDS = [Box((40.0, 20.0, 10.0)), cylinder(20.0, 10.0), tapered_capsule(40.0, 30.0, 200.0, middle_radius_mm=45.0)]
coordinate = st.floats(-120.0, 120.0)


def volume_mm3(solid: Solid) -> float:
    a, b, c = (solid.mesh.vertices_mm[solid.mesh.faces[:, i]] for i in range(3))
    return float((np.cross(a, b) * c).sum() / 6)


@pytest.mark.parametrize("solid", SOLIDS)
def test_every_edge_lies_between_two_faces_that_wind_alike(solid: Solid) -> None:
    edges = np.concatenate([solid.mesh.faces[:, [i, (i + 1) % 3]] for i in range(3)])
    assert len(np.unique(edges, axis=0)) == len(edges)
    assert {tuple(edge) for edge in edges} == {tuple(edge[::-1]) for edge in edges}


def test_faces_wind_outwards_around_the_volume_that_the_formulas_give() -> None:
    assert volume_mm3(Box((40.0, 20.0, 10.0), bevel_mm=0.001)) == pytest.approx(8000.0, rel=1e-4)
    # A prism over a regular 24-gon: 12 r² sin(15°) per unit of height.
    prism = 12 * 20.0**2 * np.sin(np.radians(15.0)) * 10.0
    assert volume_mm3(cylinder(20.0, 10.0, bevel_mm=0.001)) == pytest.approx(prism, rel=1e-3)


def test_distances_worked_by_hand() -> None:
    box, roll = SOLIDS[0], SOLIDS[1]
    points = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 9.0], [23.0, 14.0, 0.0], [19.0, 0.0, 0.0]])
    assert_allclose(box.signed_distance_mm(points), [-5.0, 4.0, 5.0, -1.0], atol=1e-12)
    points = np.array([[0.0, 0.0, 0.0], [23.0, 0.0, 0.0], [0.0, 0.0, 6.0], [0.0, 18.0, 0.0]])
    assert_allclose(roll.signed_distance_mm(points), [-5.0, 3.0, 1.0, -2.0], atol=1e-12)


@pytest.mark.parametrize("solid", SOLIDS[1:])
def test_vertices_lie_on_the_surface(solid: Solid) -> None:
    assert_allclose(solid.signed_distance_mm(solid.mesh.vertices_mm), 0.0, atol=1e-9)


@settings(max_examples=60, derandomize=True, deadline=None)
@given(st.tuples(*[coordinate] * 6))
def test_a_distance_grows_at_most_as_much_as_one_moves(numbers: tuple[float, ...]) -> None:
    points = np.array(numbers).reshape(2, 3)
    for solid in SOLIDS:
        near, far = solid.signed_distance_mm(points)
        assert abs(near - far) <= np.linalg.norm(points[0] - points[1]) + 1e-9
