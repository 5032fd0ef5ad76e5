"""Whatever is varied in a crop, its matrix says where the joints are."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pyarrow as pa
import pytest

from assemblyhands_core.hands.joints import ROOT
from assemblyhands_core.training.hand_dataset import Augmentation, HandCrops

Tables = Callable[[int], tuple[pa.Table, pa.Table]]
WILD = Augmentation(1.6, 0.15, 0.05, 40.0, 5.0, 2, 4, 0.0, 0.0)
PLAIN = Augmentation(1.5, 0.0, 0.0, 0.0, 0.0, 4, 4, 0.0, 0.0)


def hands(tables: Tables, augmentation: Augmentation, size_px: int = 64, count: int = 6) -> HandCrops:
    return HandCrops.of(*tables(count), augmentation, size_px, seed=3)


def projected(matrix: np.ndarray, points: np.ndarray) -> np.ndarray:
    x, y, depth = matrix.astype(np.float64) @ np.concatenate([points, np.ones((len(points), 1))], axis=1).T
    return np.stack([x / depth, y / depth], axis=-1)


def test_the_brightest_spot_is_where_the_matrix_puts_the_root(hand_tables: Tables) -> None:
    data = hands(hand_tables, WILD)
    for epoch in range(3):
        data.set_epoch(epoch)
        for index in range(len(data)):
            sample = data[index]
            for view in np.flatnonzero(sample["is_view_used"]):
                at = projected(sample["P_pixel_from_world"][view], sample["joints_world_mm"][ROOT : ROOT + 1])[0]
                grey = sample["images"][view].min(axis=-1).astype(float)
                weights = np.where(grey > 0.8 * grey.max(), grey, 0.0)
                rows, columns = np.mgrid[:64, :64]
                found = np.array([(weights * columns).sum(), (weights * rows).sum()]) / weights.sum()
                assert np.linalg.norm(found - at) < 1.0, (epoch, index, view)


def test_plain_boxes_are_the_mean_ones(hand_tables: Tables) -> None:
    sample = hands(hand_tables, PLAIN)[1]
    for view in range(4):
        pixels = projected(sample["P_pixel_from_world"][view], sample["joints_world_mm"])
        low, high = pixels.min(axis=0), pixels.max(axis=0)
        assert (high - low).max() == pytest.approx(64 / 1.5, rel=1e-5)
        assert (low + high) / 2 == pytest.approx([31.5, 31.5], abs=1e-3)
    np.testing.assert_array_equal(sample["root_world_mm"], sample["joints_world_mm"][ROOT])


def test_views_and_root_vary_as_stated(hand_tables: Tables) -> None:
    data, counts, errors = hands(hand_tables, WILD), set(), []
    for epoch in range(30):
        data.set_epoch(epoch)
        sample = data[1]
        counts.add(int(sample["is_view_used"].sum()))
        errors.append(sample["root_world_mm"] - sample["joints_world_mm"][ROOT])
        assert (sample["images"][~sample["is_view_used"]] == 0).all()
    assert counts == {2, 3, 4}
    assert 4.0 < np.abs(errors).max() <= 5.0 + 1e-4


def test_samples_repeat_and_epochs_differ(hand_tables: Tables) -> None:
    one, two = hands(hand_tables, WILD), hands(hand_tables, WILD)
    assert all(np.array_equal(one[2][name], two[2][name]) for name in one[2])
    before = one[2]["images"].copy()
    one.set_epoch(1)
    assert not np.array_equal(before, one[2]["images"])
    colored = hands(hand_tables, replace(PLAIN, gain_spread=0.2))
    assert not np.array_equal(colored[2]["images"], hands(hand_tables, PLAIN)[2]["images"])


def test_a_missing_view_is_never_drawn_and_sides_are_known(hand_tables: Tables) -> None:
    data = hands(hand_tables, WILD)
    assert len(data.hands[0].views) == 3 and [data[i]["is_left"] for i in range(3)] == [False, True, False]
    assert len(data.spread(3)) == 3 and data.spread(3).hands[-1].key == data.hands[-1].key
