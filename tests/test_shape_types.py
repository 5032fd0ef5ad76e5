"""The shapes in annotations are executed in the tests, for every module that states any."""

import importlib
import inspect
from pathlib import Path

import numpy as np
import pytest
from jaxtyping import TypeCheckError

import assemblyhands_core
from assemblyhands_core.geometry import transforms
from assemblyhands_core.geometry.sightlines import Sightlines
from assemblyhands_core.hands.body import hand_center

PACKAGE = Path(assemblyhands_core.__file__).parent
MODULES = sorted(
    ".".join(file.relative_to(PACKAGE.parent).with_suffix("").parts)
    for file in PACKAGE.rglob("*.py")
    if "from jaxtyping import" in file.read_text(encoding="utf-8")
)


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


@pytest.mark.parametrize("name", MODULES)
def test_every_module_that_states_shapes_is_checked(name: str) -> None:
    module = importlib.import_module(name)
    functions = [f for _, f in inspect.getmembers(module, inspect.isfunction) if f.__module__ == name]
    assert functions and all(hasattr(function, "__wrapped__") for function in functions)


def test_shapes_are_stated() -> None:
    assert len(MODULES) > 20 and "assemblyhands_core.geometry.cameras" in MODULES
