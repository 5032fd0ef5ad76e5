"""The training loop that all networks share: resumable at every epoch, the best weights kept, curves logged.

An epoch is a fixed number of steps over samples drawn anew. Everything random follows from seed and epoch, and state is
saved at the end of each epoch, so that a run that was killed goes on to the weights of one that was not (on a CPU).
State is one file, the best weights in it: two files could be of different epochs after a kill.
"""

import importlib.util
import math
import multiprocessing
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal, Protocol, cast, runtime_checkable

import numpy as np
import torch

from assemblyhands_core.models import torchvision_operators  # noqa: F401  (before lightning, which imports torchvision)
from assemblyhands_core.training.scratch import CHECKPOINT, own_folder

import lightning.pytorch as pl  # isort: skip
from lightning.pytorch.callbacks import Checkpoint  # isort: skip
from lightning.pytorch.loggers import Logger, TensorBoardLogger  # isort: skip
from torch import Tensor, nn
from torch.utils.data import DataLoader, Dataset

_WARM_UP_STEPS: Final = 60

Batch = Mapping[str, Tensor]


@runtime_checkable
class Samples(Protocol):
    """What a network is shown; a sample differs each time that it comes."""

    def __len__(self) -> int:
        """Return how many samples there are."""

    def sample(self, index: int, turn: int) -> Mapping[str, Any]:
        """Return a sample's arrays by name; ``turn``, how often it came before, decides how it is varied."""


@dataclass(frozen=True)
class Schedule:
    """How long and how fast a network is trained.

    Attributes:
        num_epochs: How many times weights are saved and judged.
        steps_per_epoch: Steps of the optimiser between.
        batch_size: Samples in a step.
        learning_rate: The highest; a short warm-up leads to it and a cosine to zero.
        weight_decay: Of AdamW.
        max_gradient: Longer gradients are shortened.
        num_loaders: Processes that make samples; 0 makes them in this one.
        seed: Of order and variations.
        devices: How many GPUs (without any: processes) share every batch, which has to be a multiple of it.
    """

    num_epochs: int
    steps_per_epoch: int
    batch_size: int
    learning_rate: float
    weight_decay: float
    max_gradient: float
    num_loaders: int
    seed: int
    devices: int = 1

    @property
    def num_steps(self) -> int:
        """Return the steps of the whole training."""
        return self.num_epochs * self.steps_per_epoch


@dataclass(frozen=True)
class Point:
    """How training stood at the end of an epoch: mean loss of its steps, error on the samples held out."""

    step: int
    loss: float
    error: float


@dataclass(frozen=True, eq=False)
class Outcome:
    """What training gave.

    Attributes:
        curve: One point an epoch.
        best: The point with the least error, whose weights the network now has.
    """

    curve: tuple[Point, ...]
    best: Point


@dataclass(frozen=True, eq=False)
class Task:
    """What a network is to learn.

    Attributes:
        network: It, with the weights to start from; trained in place.
        loss: Of a batch.
        error: Of a batch, in the unit that people look at (mm, px): mean, and number of joints it is the mean of.
        training: Samples to learn from.
        held_out: Samples to judge by, the same in every epoch.
    """

    network: nn.Module
    loss: Callable[[Batch], Tensor]
    error: Callable[[Batch], tuple[Tensor, Tensor]]
    training: Samples
    held_out: Samples


def train(task: Task, schedule: Schedule, folder: Path, num_threads: int) -> Outcome:
    """Train a network, going on from what other calls with the same arguments have left in the folder.

    Args:
        task: What is learnt.
        schedule: How long and how fast.
        folder: Where state and logs of all such calls are kept; several may be at work at once.
        num_threads: Of the CPU.

    Raises:
        ValueError: There is nothing to learn from or to judge by, or batches cannot be shared evenly.
    """
    if schedule.batch_size % schedule.devices:
        raise ValueError(f"batches of {schedule.batch_size} cannot be shared by {schedule.devices} devices")
    if not len(task.training) or not len(task.held_out):
        counts = f"{len(task.training)} samples to learn from and {len(task.held_out)} held out"
        raise ValueError(f"training has {counts}: there have to be some of both")
    torch.set_num_threads(num_threads)
    with own_folder(folder) as own:
        state = _fitted(task, schedule, own)
    # From the file, because this process has seen nothing of the training where several devices share it.
    best = state["best"]
    task.network.load_state_dict(best.pop("weights"))
    return Outcome(tuple(Point(**point) for point in state["curve"]), Point(**best))


def _fitted(task: Task, schedule: Schedule, folder: Path) -> dict[str, Any]:
    """Train to the end, from the folder's checkpoint if it has one, and return the last one."""
    is_gpu = torch.cuda.is_available()
    trainer = pl.Trainer(
        max_epochs=schedule.num_epochs,
        accelerator="gpu" if is_gpu else "cpu",  # not "auto": Apple's lacks the double precision of the projection
        devices=schedule.devices,
        strategy="auto" if schedule.devices == 1 else "ddp_fork",  # others start the whole program again on each device
        precision="bf16-mixed" if is_gpu else "32-true",
        gradient_clip_val=schedule.max_gradient,
        reload_dataloaders_every_n_epochs=1,
        num_sanity_val_steps=0,
        enable_progress_bar=False,
        enable_model_summary=False,
        log_every_n_steps=min(20, schedule.steps_per_epoch),
        callbacks=[_Saving(folder / CHECKPOINT)],
        logger=_logger(folder),
    )
    last = folder / CHECKPOINT
    trainer.fit(_Module(task, schedule), ckpt_path=last if last.is_file() else None, weights_only=True)
    return cast(dict[str, Any], torch.load(last, map_location="cpu", weights_only=True))


def _logger(folder: Path) -> Logger | Literal[False]:
    """Return TensorBoard's log if it is installed (extra `training`); the curve is kept without it, too."""
    if importlib.util.find_spec("tensorboard") is None:
        return False
    return TensorBoardLogger(folder, name="", version="tensorboard")


class _Saving(Checkpoint):
    """Replaces a checkpoint as a whole at the end of each epoch: a kill, or who copies it meanwhile, finds either."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def on_train_epoch_end(self, trainer: pl.Trainer, pl_module: pl.LightningModule) -> None:
        partial = self.path.with_name(f".{self.path.name}")
        trainer.save_checkpoint(partial)  # all devices have to ask for it, the first one writes
        if trainer.is_global_zero:
            with partial.open("rb") as file:
                os.fsync(file.fileno())
            partial.replace(self.path)


class _Module(pl.LightningModule):
    """The task as lightning wants it."""

    def __init__(self, task: Task, schedule: Schedule) -> None:
        super().__init__()
        self.network, self.task, self.schedule = task.network, task, schedule
        self.curve: list[Point] = []
        self.best: dict[str, Any] = {}  # the point with the least error, and its weights
        self._losses: list[float] = []
        self._errors: list[tuple[float, float]] = []

    def training_step(self, batch: Batch, _: int) -> Tensor:
        loss = self.task.loss(batch)
        self._losses.append(float(loss.detach()))
        self.log("loss", loss.detach())
        return loss

    def validation_step(self, batch: Batch, _: int) -> None:
        mean, count = self.task.error(batch)
        self._errors.append((float(mean) * float(count), float(count)))

    def on_validation_epoch_end(self) -> None:
        total, count = self._over_devices(np.array(self._errors).sum(axis=0))
        loss, num_losses = self._over_devices(np.array([np.sum(self._losses), len(self._losses)]))
        point = Point(self.global_step, loss / num_losses if num_losses else float("nan"), total / count)
        self.curve.append(point)
        self.log("error", point.error)
        if not self.best or point.error < self.best["error"] or math.isnan(self.best["error"]):
            weights = {name: value.detach().cpu().clone() for name, value in self.network.state_dict().items()}
            self.best = {**vars(point), "weights": weights}
        self._losses, self._errors = [], []

    def _over_devices(self, values: np.ndarray) -> tuple[float, float]:
        """Return the sums of two values over all devices."""
        sums = torch.as_tensor(self.all_gather(torch.tensor(values, device=self.device, dtype=torch.float32)))
        first, second = sums.reshape(-1, 2).double().sum(dim=0).tolist()
        return first, second

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        checkpoint["curve"], checkpoint["best"] = [vars(point) for point in self.curve], self.best

    def on_load_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        self.curve, self.best = [Point(**point) for point in checkpoint["curve"]], checkpoint["best"]

    def configure_optimizers(self) -> Any:
        schedule = self.schedule
        optimizer = torch.optim.AdamW(
            self.network.parameters(), lr=schedule.learning_rate, weight_decay=schedule.weight_decay
        )
        warm_up = min(_WARM_UP_STEPS, schedule.num_steps // 10)

        def factor(step: int) -> float:
            if step < warm_up:
                return (step + 1) / warm_up
            done = (step - warm_up) / max(schedule.num_steps - warm_up, 1)
            return 0.5 * (1 + float(np.cos(np.pi * min(done, 1.0))))

        scheduler = torch.optim.lr_scheduler.LambdaLR(optimizer, factor)
        return {"optimizer": optimizer, "lr_scheduler": {"scheduler": scheduler, "interval": "step"}}

    def train_dataloader(self) -> DataLoader[Any]:
        schedule, data = self.schedule, self.task.training
        rng = np.random.default_rng([schedule.seed, self.current_epoch])
        wanted = schedule.steps_per_epoch * schedule.batch_size
        num_turns = -(-wanted // len(data))
        turns = [turn * len(data) + rng.permutation(len(data)) for turn in range(num_turns)]
        return self._loader(_Epoch(data, self.current_epoch * num_turns), np.concatenate(turns)[:wanted].tolist())

    def val_dataloader(self) -> DataLoader[Any]:
        return self._loader(_Epoch(self.task.held_out, 0), list(range(len(self.task.held_out))))

    def _loader(self, data: "_Epoch", order: list[int]) -> DataLoader[Any]:
        can_fork = not multiprocessing.current_process().daemon  # Dask's workers may have no children
        return DataLoader(
            data,
            batch_size=self.schedule.batch_size // self.schedule.devices,
            sampler=order,
            num_workers=self.schedule.num_loaders if can_fork else 0,
            pin_memory=torch.cuda.is_available(),
        )


@dataclass(frozen=True, eq=False)
class _Epoch(Dataset[Mapping[str, Any]]):
    """The samples of one epoch as torch takes them; those of a small set come several times, varied anew each time.

    Attributes:
        samples: All.
        first_turn: How many times they have come in earlier epochs.
    """

    samples: Samples
    first_turn: int

    def __len__(self) -> int:
        return len(self.samples)

    def __getitem__(self, number: int) -> Mapping[str, Any]:
        turn, index = divmod(number, len(self.samples))
        return self.samples.sample(index, self.first_turn + turn)
