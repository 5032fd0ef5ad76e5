"""Training lowers the loss, and one that was interrupted ends with the weights of one that was not."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pyarrow as pa
import pytest
import torch

from assemblyhands_core.models.hand_keypoints import HandKeypointConfig, HandKeypointNet
from assemblyhands_core.training.hand_dataset import Augmentation, HandCrops
from assemblyhands_core.training.loop import Outcome, Schedule, train
from assemblyhands_core.training.tasks import keypoint_task, used_views

Tables = Callable[[int], tuple[pa.Table, pa.Table]]
AUGMENTATION = Augmentation(1.5, 0.1, 0.02, 5.0, 0.0, 1, 1, 0.0, 0.0)
SCHEDULE = Schedule(4, 8, 8, 1e-2, 1e-3, 5.0, num_loaders=0, seed=5)


def fit(tables: Tables, folder: Path, schedule: Schedule = SCHEDULE) -> tuple[Outcome, dict[str, torch.Tensor]]:
    torch.manual_seed(0)
    network = HandKeypointNet(HandKeypointConfig(num_levels=2, num_channels=8, image_size_px=64))
    data = HandCrops.of(*tables(12), AUGMENTATION, 64, seed=1)
    outcome = train(keypoint_task(network, data, data.spread(4)), schedule, folder, num_threads=1)
    return outcome, network.state_dict()


def test_the_loss_falls_and_the_best_weights_are_kept(hand_tables: Tables, tmp_path: Path) -> None:
    outcome, _ = fit(hand_tables, tmp_path)
    losses = [point.loss for point in outcome.curve]
    assert [point.step for point in outcome.curve] == [8, 16, 24, 32]
    assert losses[-1] < 0.9 * losses[0]
    assert outcome.best.error == min(point.error for point in outcome.curve)
    assert list((tmp_path / "tensorboard").glob("events.*"))


def test_an_interrupted_training_goes_on_to_the_same_weights(hand_tables: Tables, tmp_path: Path) -> None:
    whole, expected = fit(hand_tables, tmp_path / "whole")

    class Killed(Exception):
        pass

    def killed(tables: Tables) -> None:
        torch.manual_seed(0)
        network = HandKeypointNet(HandKeypointConfig(num_levels=2, num_channels=8, image_size_px=64))
        data = HandCrops.of(*tables(12), AUGMENTATION, 64, seed=1)
        task, calls = keypoint_task(network, data, data.spread(4)), []

        def loss(batch: object) -> torch.Tensor:
            calls.append(0)
            if len(calls) == 19:  # in the middle of the third epoch
                raise Killed
            return task.loss(batch)  # type: ignore[arg-type]

        train(replace(task, loss=loss), SCHEDULE, tmp_path / "cut", num_threads=1)

    with pytest.raises(Killed):
        killed(hand_tables)
    resumed, found = fit(hand_tables, tmp_path / "cut")
    assert [vars(p) for p in resumed.curve] == [vars(p) for p in whole.curve]
    assert all(torch.equal(found[name], expected[name]) for name in expected)


def test_only_joints_in_the_picture_count(hand_tables: Tables) -> None:
    data = HandCrops.of(*hand_tables(4), replace(AUGMENTATION, gamma=1.0, center_spread=0.4), 64, seed=1)
    batch = torch.utils.data.default_collate([data[i] for i in range(4)])
    images, pixels, is_valid, is_left = used_views(batch, 64)
    assert images.shape == (4, 3, 64, 64) and is_left.tolist() == [False, True, False, True]
    assert 0.2 < is_valid.float().mean() < 1.0
    assert ((pixels[is_valid] > -0.5) & (pixels[is_valid] < 63.5)).all() and (pixels[~is_valid] == 0).all()


def test_nothing_to_learn_from_is_said(hand_tables: Tables, tmp_path: Path) -> None:
    network = HandKeypointNet(HandKeypointConfig(num_levels=2, num_channels=8, image_size_px=64))
    data = HandCrops.of(*hand_tables(2), AUGMENTATION, 64, seed=1)
    empty = replace(data, hands=(), labels=())
    with pytest.raises(ValueError, match="2 samples to learn from and 0 held out"):
        train(keypoint_task(network, data, empty), SCHEDULE, tmp_path, num_threads=1)
