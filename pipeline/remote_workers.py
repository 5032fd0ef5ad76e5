"""Workers of a scheduler on any machine: who is there, who has a GPU, and whether anyone still comes."""

import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, Final

from pipeline.config import UserError
from pipeline.workers import Place

GPU: Final = "GPU"
"""What a worker offers that sees one: ``dask worker … --resources GPU=1``."""

NO_DASHBOARD: Final[dict[str, Any]] = {"dashboard": False, "dashboard_address": "127.0.0.1:0"}
"""Of a scheduler or worker; without the address it would answer questions about its health to everybody."""

_LOOK_S: Final = 1.0
_ANSWER_S: Final = 10.0  # of a scheduler; for one that is frozen Dask's client would wait for ever


@dataclass
class RemoteWorkers:
    """Workers that come and go.

    Attributes:
        client: Dask's client of them.
        address: of the scheduler.
        max_workers: how many are used at most; 0: all.
        wait_s: how long no worker at all may be there.
        problem: says why none will come, nothing while one may.
    """

    client: Any
    address: str
    max_workers: int
    wait_s: float
    problem: Callable[[], str] = str
    _infos: dict[str, Any] = field(default_factory=dict)
    _answers: bool = True
    _looked_at: float = float("-inf")
    _seen_at: float = field(default_factory=time.monotonic)

    def places(self) -> list[Place]:
        """Return all workers, those with a GPU apart from the others if there are both."""
        self._look()
        with_gpu = tuple(address for address, info in self._infos.items() if info["resources"].get(GPU))
        others = tuple(address for address in self._infos if address not in with_gpu)
        if with_gpu and others:
            return [Place("gpu", len(with_gpu), (True,), with_gpu), Place("cpu", len(others), (False,), others)]
        return [Place("all", len(self._infos))]

    def note_progress(self) -> None:
        """Do nothing: whoever lets a task's workers die is found by Dask's own count."""

    def check_alive(self) -> None:
        """Look whether the scheduler and any worker are there.

        Raises:
            UserError: if the scheduler is gone, did not answer or had no worker for too long, or none will come.
        """
        if self.client.status == "closed":
            raise UserError(
                f"the scheduler at {self.address} is gone; what was finished is kept: start it and its workers again, "
                "and repeat the command"
            )
        if problem := self.problem():
            raise UserError(problem)
        self._look()
        if time.monotonic() - self._seen_at <= self.wait_s:
            return
        if not self._answers:
            raise UserError(
                f"the scheduler at {self.address} has not answered for {self.wait_s:.0f} s; what was finished is kept: "
                "start it and its workers again, and repeat the command (executor.wait_s says how long to wait)"
            )
        raise UserError(
            f"the scheduler at {self.address} has had no worker for {self.wait_s:.0f} s; what was finished is "
            "kept: start workers and repeat the command (executor.wait_s says how long to wait)"
        )

    def wait(self) -> None:
        """Wait for the first worker.

        Raises:
            UserError: if none comes.
        """
        self._seen_at = time.monotonic()
        while not self.places()[0].num_workers:
            self.check_alive()
            time.sleep(_LOOK_S / 10)

    def ask(self) -> dict[str, Any]:
        """Ask the scheduler for all its workers and what each of them is; none while it does not answer."""
        self._answers = False
        with suppress(OSError, TimeoutError):
            identity = self.client.sync(_identity, self.client, callback_timeout=_ANSWER_S)
            self._answers = bool(identity)
            return dict(identity.get("workers", {}))
        return {}

    def _look(self) -> None:
        """Ask the scheduler who is there, not too often."""
        if time.monotonic() - self._looked_at < _LOOK_S:
            return
        workers = self.ask()
        self._looked_at = time.monotonic()
        self._infos = dict(sorted(workers.items())[: self.max_workers or None])
        if self._infos:
            self._seen_at = self._looked_at


async def _identity(client: Any) -> dict[str, Any]:
    """Return what the scheduler says of itself; nothing once the client has given it up."""
    return await client.scheduler.identity(n_workers=-1) if client.scheduler else {}
