"""Whatever is varied in a crop, its matrix says where the joints are."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pyarrow as pa
import pytest

from assemblyhands_core.data.hand_crops import stored_hands
from assemblyhands_core.hands.joints import ROOT
from assemblyhands_core.training.hand_dataset import Augmentation, HandCrops

Tables = Callable[[int], tuple[pa.Table, pa.Table]]
WILD = Augmentation(1.6, 0.15, 0.05, 40.0, 5.0, 2, 4, 0.0, 0.0)
PLAIN = Augmentation(1.2, 0.0, 0.0, 0.0, 0.0, 4, 4, 0.0, 0.0)


def hands(tables: Tables, augmentation: Augmentation, size_px: int = 64, count: int = 6) -> HandCrops:
    crops, labels = tables(count)
    return HandCrops.of(stored_hands(crops), labels, augmentation, size_px, seed=3)


def projected(matrix: np.ndarray, points: np.ndarray) -> np.ndarray:
    x, y, depth = matrix.astype(np.float64) @ np.concatenate([points, np.ones((len(points), 1))], axis=1).T
    return np.stack([x / depth, y / depth], axis=-1)


def test_the_brightest_spot_is_where_the_matrix_puts_the_root(hand_tables: Tables) -> None:
    data = hands(hand_tables, WILD)
    for epoch in range(3):
        for index in range(len(data)):
            sample = data.sample(index, epoch)
            for view in np.flatnonzero(sample["is_view_used"]):
                at = projected(sample["P_pixel_from_world"][view], sample["joints_world_mm"][ROOT : ROOT + 1])[0]
                grey = sample["images"][view].min(axis=-1).astype(float)
                weights = np.where(grey > 0.8 * grey.max(), grey, 0.0)
                rows, columns = np.mgrid[:64, :64]
                found = np.array([(weights * columns).sum(), (weights * rows).sum()]) / weights.sum()
                assert np.linalg.norm(found - at) < 1.0, (epoch, index, view)


def test_plain_boxes_are_the_mean_ones(hand_tables: Tables) -> None:
    sample = hands(hand_tables, PLAIN).sample(1, 0)
    for view in range(4):
        pixels = projected(sample["P_pixel_from_world"][view], sample["joints_world_mm"])
        low, high = pixels.min(axis=0), pixels.max(axis=0)
        assert (high - low).max() == pytest.approx(64 / 1.2, rel=1e-5)
        assert (low + high) / 2 == pytest.approx([31.5, 31.5], abs=1e-3)
    np.testing.assert_array_equal(sample["root_world_mm"], sample["joints_world_mm"][ROOT])


def test_views_and_root_vary_as_stated(hand_tables: Tables) -> None:
    data, counts, errors = hands(hand_tables, WILD), set(), []
    for epoch in range(30):
        sample = data.sample(1, epoch)
        counts.add(int(sample["is_view_used"].sum()))
        errors.append(sample["root_world_mm"] - sample["joints_world_mm"][ROOT])
        assert (sample["images"][~sample["is_view_used"]] == 0).all()
    assert counts == {2, 3, 4}
    assert 4.0 < np.abs(errors).max() <= 5.0 + 1e-4


def test_samples_repeat_and_epochs_differ(hand_tables: Tables) -> None:
    one, two = hands(hand_tables, WILD), hands(hand_tables, WILD)
    first, again = one.sample(2, 0), two.sample(2, 0)
    assert all(np.array_equal(first[name], again[name]) for name in first)
    assert not np.array_equal(first["images"], one.sample(2, 1)["images"])
    plain, colored = hands(hand_tables, PLAIN), hands(hand_tables, replace(PLAIN, gain_spread=0.2))
    assert not np.array_equal(colored.sample(2, 0)["images"], plain.sample(2, 0)["images"])


def test_a_missing_view_is_never_drawn_and_sides_are_known(hand_tables: Tables) -> None:
    data = hands(hand_tables, WILD)
    assert len(data.hands[0].views) == 3 and [data.sample(i, 0)["is_left"] for i in range(3)] == [False, True, False]
    assert len(data.spread(3)) == 3 and data.spread(3).hands[-1].key == data.hands[-1].key


def test_beyond_the_stored_crop_it_is_continued_and_nowhere_black(hand_tables: Tables) -> None:
    loose = replace(WILD, gamma=3.5, gamma_spread=0.3, center_spread=0.3)
    data, num_beyond = hands(hand_tables, loose), 0
    for epoch in range(10):
        sample = data.sample(1, epoch)
        for slot in np.flatnonzero(sample["is_view_used"]):
            assert sample["images"][slot].min() > 5, "the darkest thing in the pictures is grey"
            points = projected(sample["P_pixel_from_world"][slot], sample["joints_world_mm"])
            num_beyond += bool((points.max(axis=0) - points.min(axis=0)).max() < 64 / 4)  # the stored crop is γ 2 or so
    assert num_beyond > 3


def test_hands_of_which_no_box_can_be_drawn_are_left_out(hand_tables: Tables) -> None:
    crops, labels = hand_tables(4)
    valid = np.ones((labels.num_rows, 21), dtype=bool)
    valid[1] = np.arange(21) == ROOT  # one joint spans no box
    column = pa.FixedSizeListArray.from_arrays(pa.array(valid.ravel()), 21)
    labels = labels.set_column(labels.schema.get_field_index("valid"), "valid", column)
    data = HandCrops.of(stored_hands(crops), labels, WILD, 64, seed=3)
    whole = hands(hand_tables, WILD, count=4)
    assert len(data) == len(whole) - 1 and {hand.key for hand in whole.hands} - {hand.key for hand in data.hands}
