"""Training lowers the loss, and one that was interrupted ends with the weights of one that was not."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
import torch

from assemblyhands_core.data.hand_crops import stored_hands
from assemblyhands_core.models.hand_keypoints import HandKeypointConfig, HandKeypointNet
from assemblyhands_core.models.heatmaps import soft_argmax
from assemblyhands_core.training.hand_dataset import Augmentation, HandCrops
from assemblyhands_core.training.loop import Batch, Outcome, Schedule, Task, train
from assemblyhands_core.training.scratch import remove_idle
from assemblyhands_core.training.tasks import keypoint_task, used_views

Tables = Callable[[int], tuple[pa.Table, pa.Table]]
AUGMENTATION = Augmentation(1.5, 0.1, 0.02, 5.0, 0.0, 1, 1, 0.0, 0.0)
SCHEDULE = Schedule(4, 8, 8, 1e-2, 1e-3, 5.0, num_loaders=0, seed=5)


def crops(tables: Tables, count: int, augmentation: Augmentation = AUGMENTATION) -> HandCrops:
    stored, labels = tables(count)
    return HandCrops.of(stored_hands(stored), labels, augmentation, 64, seed=1)


def task_of(tables: Tables, seed: int = 0) -> Task:
    torch.manual_seed(seed)
    network = HandKeypointNet(HandKeypointConfig(num_levels=2, num_channels=8, image_size_px=64))
    data = crops(tables, 12)
    return keypoint_task(network, data, data.spread(4))


def counted(task: Task, kill_at: int = 0) -> tuple[Task, list[int]]:
    """Return the task, and a list that grows with every loss; the loss of that number kills."""
    calls: list[int] = []

    def loss(batch: Batch) -> torch.Tensor:
        calls.append(0)
        if len(calls) == kill_at:
            raise Killed
        return task.loss(batch)

    return replace(task, loss=loss), calls


class Killed(Exception):
    pass


def judged(task: Task) -> float:
    """Return the error of a task's network on what is held out, as it is now."""
    task.network.eval()
    batch = torch.utils.data.default_collate([task.held_out.sample(i, 0) for i in range(len(task.held_out))])
    with torch.no_grad():
        return float(task.error(batch)[0])


def test_the_loss_falls_and_the_best_weights_are_kept(hand_tables: Tables, tmp_path: Path) -> None:
    task = task_of(hand_tables)
    fast = replace(SCHEDULE, num_epochs=6, learning_rate=0.03)
    outcome = train(task, fast, tmp_path, num_threads=1)
    losses = [point.loss for point in outcome.curve]
    assert [point.step for point in outcome.curve] == [8, 16, 24, 32, 40, 48]
    assert losses[-1] < 0.9 * losses[0]
    assert outcome.best.error == min(point.error for point in outcome.curve)
    assert judged(task) == pytest.approx(outcome.best.error, rel=1e-4)
    assert list(tmp_path.glob("*/tensorboard/events.*"))


class Numbered:
    """Five samples that note when they come, and teach nothing."""

    def __init__(self) -> None:
        self.seen: list[tuple[int, int]] = []

    def __len__(self) -> int:
        return 5

    def sample(self, index: int, turn: int) -> dict[str, torch.Tensor]:
        self.seen.append((index, turn))
        return {"x": torch.ones(1)}


def test_a_small_set_is_varied_anew_each_time_that_it_comes(tmp_path: Path) -> None:
    network, samples = torch.nn.Linear(1, 1), Numbered()
    task = Task(
        network,
        loss=lambda batch: network(batch["x"]).square().mean(),
        error=lambda batch: (torch.tensor(1.0), torch.tensor(1)),
        training=samples,
        held_out=Numbered(),
    )
    train(task, Schedule(2, 3, 4, 1e-2, 0.0, 5.0, num_loaders=0, seed=5), tmp_path, num_threads=1)
    assert len(samples.seen) == 24 == len(set(samples.seen)), "two epochs of 3 × 4, nothing twice"
    first, second = samples.seen[:12], samples.seen[12:]
    for epoch, turns in ((first, (0, 1, 2)), (second, (3, 4, 5))):
        assert [turn for _, turn in epoch] == [turns[0]] * 5 + [turns[1]] * 5 + [turns[2]] * 2
        assert {index for index, _ in epoch[:5]} == {index for index, _ in epoch[5:10]} == set(range(5))


def test_weights_that_got_worse_afterwards_are_not_what_is_kept(hand_tables: Tables, tmp_path: Path) -> None:
    task = task_of(hand_tables)
    errors = iter([3.0, 1.0, 2.0, 4.0])
    spoilt = replace(
        task, error=lambda _: (torch.tensor(next(errors)), torch.tensor(1)), held_out=crops(hand_tables, 12).spread(1)
    )
    states: list[dict[str, torch.Tensor]] = []

    def loss(batch: Batch) -> torch.Tensor:
        states.append({name: value.clone() for name, value in task.network.state_dict().items()})
        return task.loss(batch)

    outcome = train(replace(spoilt, loss=loss), SCHEDULE, tmp_path, num_threads=1)
    assert [point.error for point in outcome.curve] == [3.0, 1.0, 2.0, 4.0] and outcome.best.step == 16
    parameters = dict(task.network.named_parameters())
    assert all(torch.equal(value, states[16][name]) for name, value in parameters.items()), "weights after 16 steps"
    assert not all(torch.equal(value, states[31][name]) for name, value in parameters.items())


@pytest.mark.parametrize("num_loaders", [0, 1])
def test_an_interrupted_training_goes_on_to_the_same_weights(
    hand_tables: Tables, tmp_path: Path, num_loaders: int
) -> None:
    schedule = replace(SCHEDULE, num_loaders=num_loaders)
    whole_task = task_of(hand_tables)
    whole = train(whole_task, schedule, tmp_path / "whole", num_threads=1)
    with pytest.raises(Killed):
        train(counted(task_of(hand_tables), kill_at=19)[0], schedule, tmp_path / "cut", num_threads=1)  # third epoch
    other, calls = counted(task_of(hand_tables, seed=9))  # what it starts from does not matter any more
    resumed = train(other, schedule, tmp_path / "cut", num_threads=1)
    assert len(calls) == 16, "the first two epochs are not done again"
    assert [vars(p) for p in resumed.curve] == [vars(p) for p in whole.curve]
    expected, found = whole_task.network.state_dict(), other.network.state_dict()
    assert all(torch.equal(found[name], expected[name]) for name in expected)


def beside(task: Task, other: Callable[[], object], at: int) -> Task:
    """Return the task, with something else that happens while a loss of that number is found."""
    calls: list[int] = []

    def loss(batch: Batch) -> torch.Tensor:
        calls.append(0)
        if len(calls) == at:
            other()
        return task.loss(batch)

    return replace(task, loss=loss)


@pytest.mark.parametrize("is_first_to_end", [False, True])
def test_two_trainings_of_the_same_thing_do_not_mix(hand_tables: Tables, tmp_path: Path, is_first_to_end: bool) -> None:
    """As when a host that was cut off goes on: the second one comes after two epochs, and ends before the first one."""
    schedule = replace(SCHEDULE, num_epochs=3, learning_rate=0.05)
    other, calls = counted(task_of(hand_tables, seed=9))
    spoilt = replace(
        other, loss=lambda batch: other.loss(batch) * float("nan") if len(calls) > 4 else other.loss(batch)
    )
    outcomes: list[Outcome] = []

    def train_other() -> None:
        outcomes.append(train(spoilt, schedule, tmp_path / "scratch", num_threads=1))
        if is_first_to_end:
            remove_idle(tmp_path / "scratch")

    first = task_of(hand_tables)
    outcomes.append(train(beside(first, train_other, at=19), schedule, tmp_path / "scratch", num_threads=1))
    second, whole = outcomes
    alone = train(task_of(hand_tables), schedule, tmp_path / "alone", num_threads=1)
    assert [vars(point) for point in whole.curve] == [vars(point) for point in alone.curve]
    assert judged(first) == pytest.approx(whole.best.error, rel=1e-4)
    assert len(calls) == 8, "the second one goes on from a copy of what the first one had saved"
    assert second.curve[:2] == whole.curve[:2] and second.curve[2] != whole.curve[2]
    assert judged(other) == pytest.approx(second.best.error, rel=1e-4)
    remove_idle(tmp_path / "scratch")
    assert not (tmp_path / "scratch").exists()


def test_two_devices_share_every_batch_and_take_as_many_steps(hand_tables: Tables, tmp_path: Path) -> None:
    one, two = task_of(hand_tables), task_of(hand_tables)
    alone = train(one, replace(SCHEDULE, num_epochs=2), tmp_path / "one", num_threads=1)
    shared = train(two, replace(SCHEDULE, num_epochs=2, devices=2), tmp_path / "two", num_threads=1)
    assert [point.step for point in shared.curve] == [point.step for point in alone.curve] == [8, 16]
    assert shared.curve[0].loss == pytest.approx(alone.curve[0].loss, rel=0.1)  # batch norms see half batches
    assert shared.curve[1].loss < shared.curve[0].loss
    assert judged(two) == pytest.approx(shared.best.error, rel=1e-4)
    with pytest.raises(ValueError, match="batches of 8 cannot be shared by 3 devices"):
        train(two, replace(SCHEDULE, devices=3), tmp_path / "three", num_threads=1)


@pytest.mark.parametrize("is_mixed", [False, True])
def test_mixed_precision_leaves_labels_and_readings_as_they_are(hand_tables: Tables, is_mixed: bool) -> None:
    data = crops(hand_tables, 4)
    batch = torch.utils.data.default_collate([data.sample(i, 0) for i in range(4)])
    heatmaps = torch.full((1, 1, 80, 80), -20.0)
    heatmaps[0, 0, 77, 70:72] = 20.0
    with torch.autocast("cpu", torch.bfloat16, enabled=is_mixed):
        _, pixels, _, _ = used_views(batch, 64)
        cells = soft_argmax(heatmaps)
    points = np.concatenate([batch["joints_world_mm"].numpy(), np.ones((4, 21, 1))], axis=-1).astype(np.float64)
    u, v, depth = np.moveaxis(
        batch["P_pixel_from_world"][:, 0].numpy().astype(np.float64) @ points.swapaxes(1, 2), 1, 0
    )
    np.testing.assert_allclose(pixels, np.stack([u / depth, v / depth], axis=-1), rtol=0, atol=2e-3)
    np.testing.assert_allclose(cells[0, 0], [77.0, 70.5], rtol=0, atol=1e-4)


def test_only_joints_in_the_picture_count(hand_tables: Tables) -> None:
    data = crops(hand_tables, 4, replace(AUGMENTATION, gamma=1.0, center_spread=0.4))
    batch = torch.utils.data.default_collate([data.sample(i, 0) for i in range(4)])
    images, pixels, is_valid, is_left = used_views(batch, 64)
    assert images.shape == (4, 3, 64, 64) and is_left.tolist() == [False, True, False, True]
    assert 0.2 < is_valid.float().mean() < 1.0
    assert ((pixels[is_valid] > -0.5) & (pixels[is_valid] < 63.5)).all() and (pixels[~is_valid] == 0).all()


def test_nothing_to_learn_from_is_said(hand_tables: Tables, tmp_path: Path) -> None:
    network = HandKeypointNet(HandKeypointConfig(num_levels=2, num_channels=8, image_size_px=64))
    data = crops(hand_tables, 2)
    empty = replace(data, hands=(), labels=())
    with pytest.raises(ValueError, match="2 samples to learn from and 0 held out"):
        train(keypoint_task(network, data, empty), SCHEDULE, tmp_path, num_threads=1)
