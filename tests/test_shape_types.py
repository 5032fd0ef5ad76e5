"""The shapes in annotations are executed in the tests, in every module of the core."""

import sys

import numpy as np
import pytest
from jaxtyping import TypeCheckError

from assemblyhands_core.geometry import transforms
from assemblyhands_core.geometry.sightlines import Sightlines
from assemblyhands_core.hands.body import hand_center


def test_a_wrong_shape_is_refused() -> None:
    points = np.zeros((4, 5, 3))
    assert transforms.apply(np.eye(4), points).shape == (4, 5, 3)
    with pytest.raises(TypeCheckError, match=r"(?s)transforms\.apply.*parameter 'points'"):
        transforms.apply(np.eye(4), points[..., :2])


def test_shapes_that_do_not_fit_one_another_are_refused() -> None:
    with pytest.raises(TypeCheckError, match="hand_center"):
        hand_center(np.zeros((4, 3)), np.zeros((5, 3)))


def test_a_wrong_type_is_refused() -> None:
    with pytest.raises(TypeCheckError, match=r"(?s)transforms\.inverse.*Float\[ndarray, '4 4'\]"):
        transforms.inverse(np.eye(4, dtype=np.int64))


def test_the_fields_of_a_dataclass_are_checked_together() -> None:
    rays, rows, centers, confidence = np.zeros((7, 2, 3)), np.zeros((7, 2, 2, 3)), np.zeros((2, 3)), np.zeros((7, 2))
    assert Sightlines(rays, rows, centers, confidence).usable.shape == (7, 2)
    with pytest.raises(TypeCheckError, match="centers_mm"):
        Sightlines(rays, rows, centers[:1], confidence)


@pytest.mark.usefixtures("unchecked_types")
def test_a_test_can_do_without_the_checks() -> None:
    assert transforms.inverse(np.eye(4, dtype=np.int64)).shape == (4, 4)


def test_no_module_of_the_core_was_imported_before_the_hook() -> None:
    core = {name: module for name, module in sys.modules.items() if name.split(".")[0] == "assemblyhands_core"}
    unchecked = [name for name, module in core.items() if "jaxtyping" not in type(module.__spec__.loader).__module__]
    assert transforms.__name__ in core and not unchecked
