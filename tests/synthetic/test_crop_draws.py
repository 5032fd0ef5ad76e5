"""Which instants are drawn: spread out, different, repeatable, none of a recording."""

import pickle

import numpy as np
import pytest

from assemblyhands_core.synthetic.crop_draws import draw_training_take


def test_instants_lie_within_the_take_and_apart() -> None:
    for seed in range(20):
        drawn = draw_training_take(1, seed, num_instants=8, duration_s=16.0)
        assert len(drawn.times_s) == 8 and min(drawn.times_s) > 0.0 and max(drawn.times_s) < 16.0
        assert np.diff(drawn.times_s).min() > 0.99  # half of 2 s


def test_draws_differ_and_repeat() -> None:
    drawn = [draw_training_take(subject, seed) for subject in range(4) for seed in range(25)]
    assert drawn == [draw_training_take(subject, seed) for subject in range(4) for seed in range(25)]
    assert pickle.loads(pickle.dumps(drawn)) == drawn  # workers get them
    assert len({take.take_seed for take in drawn}) == len({take.day_seed for take in drawn}) == 100
    assert draw_training_take(0, 0, "desktop").take_seed != draw_training_take(0, 0).take_seed


def test_no_take_or_day_of_a_recording_is_drawn() -> None:
    for seed in range(100):
        drawn = draw_training_take(3, seed)
        assert drawn.take_seed > 2**32 - 1  # recordings: a CRC-32
        assert drawn.day_seed > 99_999_999  # recordings: year, month and day


def test_both_hands_of_every_instant_are_yielded() -> None:
    drawn = draw_training_take(2, 1, "desktop", num_instants=2, duration_s=2.0)
    found = list(drawn.views(32, camera_ids=("D01_rgb", "D08_rgb")))
    assert [(views.t_s, views.hand) for views in found] == [(t, h) for t in drawn.times_s for h in ("right", "left")]
    assert all(views.images.shape == (2, 32, 32, 3) and views.is_valid.all() for views in found)
    assert found[0].images[0].std() > 5.0
    assert found[0].joints_world_mm.mean(axis=0) != pytest.approx(found[2].joints_world_mm.mean(axis=0), abs=0.1)
