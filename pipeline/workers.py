"""What an executor has to know of Dask's workers, wherever they are."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from pipeline.task_queue import ANY_TASK


@dataclass(frozen=True)
class Place:
    """Workers that take the same tasks.

    Attributes:
        name: of the place, unique among all.
        num_workers: how many tasks it takes at a time.
        uses_gpu: of which stages: those that use a GPU, the others, or both.
        addresses: of the workers; None if any will do.
    """

    name: str
    num_workers: int
    uses_gpu: Collection[bool] = ANY_TASK
    addresses: tuple[str, ...] | None = None


class Workers(Protocol):
    """Dask workers that are watched."""

    @property
    def client(self) -> Any:
        """Return Dask's client of them."""

    def places(self) -> Sequence[Place]:
        """Return where tasks can be sent now."""

    def note_progress(self) -> None:
        """Learn that a task has ended."""

    def check_alive(self) -> None:
        """Look whether anyone is left to work.

        Raises:
            UserError: if not, and nobody will come.
        """
