"""Parts: how they rest, what hangs on what, how they are gripped."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from assemblyhands_core.geometry import transforms
from assemblyhands_core.synthetic.motion import shifted
from assemblyhands_core.synthetic.objects import Mount, Part, PartSet, grip_from_above, piece
from assemblyhands_core.synthetic.solids import Box


def block(name: str, parent: str | None, is_lying: bool = False) -> Part:
    mount = Mount(parent, shifted(1.0, 2.0, 3.0)) if parent else None
    grip = grip_from_above("pinch", 20.0, 8.0, 2)
    return Part(name, "block", (piece(Box((40.0, 20.0, 10.0)), (1, 0, 0)),), 5.0, grip, is_lying=is_lying, mount=mount)


def test_a_part_rests_on_the_table_with_z_up_or_lying_with_x_up() -> None:
    upright = block("a", None).resting(30.0, 70.0, 0.4, -20.0)
    assert_allclose(upright[:3, 2], [0, 1, 0], atol=1e-12)
    assert_allclose(upright[:3, 3], [30.0, -15.0, 70.0])
    lying = block("a", None, is_lying=True).resting(0.0, 0.0, 1.1, -20.0)
    assert_allclose(lying[:3, 0], [0, 1, 0], atol=1e-12)
    for pose in (upright, lying):
        assert transforms.reason_not_rigid(pose) is None


def test_parts_know_what_they_hang_on() -> None:
    parts = PartSet("t", "tower", "a", {p.name: p for p in (block("a", None), block("b", "a"), block("c", "b"))})
    assert parts.root("c") == "a" and parts.children == {"a": ("b",), "b": ("c",), "c": ()}
    assert_allclose(parts.T_root_from_part("c"), shifted(2.0, 4.0, 6.0))


def test_a_part_of_two_pieces_is_their_union() -> None:
    part = Part(
        "a",
        "block",
        (piece(Box((10.0, 10.0, 10.0)), (1, 0, 0)), piece(Box((10.0, 10.0, 10.0)), (0, 1, 0), (20.0, 0.0, 0.0))),
        5.0,
        grip_from_above("pinch", 10.0, 0.0, 1),
    )
    points = np.array([[0.0, 0.0, 0.0], [20.0, 0.0, 0.0], [9.0, 0.0, 0.0], [27.0, 0.0, 0.0]])
    assert_allclose(part.signed_distance_mm(points), [-5.0, -5.0, 4.0, 2.0], atol=1e-12)
    assert part.faces.max() == len(part.vertices_mm) - 1 == 47
    assert part.radius_mm == pytest.approx(np.sqrt(25.0**2 + 3.0**2 + 3.0**2), rel=0.02)
    assert_allclose(part.albedo[[0, -1]], [[1, 0, 0], [0, 1, 0]])


def test_a_grip_from_above_comes_down_on_the_part() -> None:
    grip = grip_from_above("tripod", 20.0, 8.0, 2)
    assert_allclose(grip.T_part_from_grip[:3, 2], [0, 0, -1])
    assert_allclose(grip.T_part_from_grip[:3, 3], [0, 0, 8.0])
