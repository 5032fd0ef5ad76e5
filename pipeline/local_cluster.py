"""Worker processes on this machine, scheduled by Dask on the loopback interface."""

import logging
import signal
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from multiprocessing import resource_tracker
from typing import Any

from pipeline.config import UserError
from pipeline.workers import Place

# OpenCV and BLAS would each start a thread per core in every worker.
THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OPENCV_FOR_THREADS_NUM")
# Freed memory is kept for what comes next: rendering, which takes and frees pictures all the time, is a tenth faster.
KEPT_MEMORY = {"MALLOC_MMAP_THRESHOLD_": str(2**28), "MALLOC_TRIM_THRESHOLD_": str(2**30)}
_MAX_STARTS = 3
_MAX_LOST = 1  # workers that a task may lose before it is suspected of killing them
_MAX_LIVES = 6  # of each worker without anything done


@dataclass
class LocalWorkers:
    """The worker processes, watched: Dask revives the dead for ever, also those that die before they can do anything.

    Attributes:
        client: Dask's client of them.
        num_workers: how many there are; each runs one task at a time.
    """

    client: Any
    num_workers: int
    _nannies: Callable[[], Iterable[Any]]
    _seen_pids: set[int] = field(default_factory=set)

    def places(self) -> list[Place]:
        """Return the one place that all workers are."""
        return [Place("here", self.num_workers)]

    def note_progress(self) -> None:
        """Forgive the deaths so far: something was done meanwhile."""
        self._seen_pids.clear()

    def check_alive(self) -> None:
        """Look who is alive.

        Raises:
            UserError: if workers have died again and again since anything was done.
        """
        self._seen_pids.update(nanny.pid for nanny in self._nannies() if nanny.pid)
        if len(self._seen_pids) > _MAX_LIVES * self.num_workers:
            raise UserError(
                f"worker processes have died {len(self._seen_pids)} times and got nothing done; raise "
                "executor.memory_limit or lower executor.num_workers, or see why with executor=serial"
            )


@contextmanager
def local_workers(num_workers: int, num_threads: int, memory_limit: str) -> Iterator[LocalWorkers]:
    """Give so many worker processes, and end them all afterwards.

    Raises:
        UserError: if they do not start.
    """
    import dask
    from distributed import Client

    settings = {
        "distributed.nanny.pre-spawn-environ": dict.fromkeys(THREAD_VARIABLES, str(num_threads)) | KEPT_MEMORY,
        "distributed.worker.daemon": True,
        "distributed.scheduler.allowed-failures": _MAX_LOST,
        "distributed.logging.distributed": "critical",  # a lost worker is our own sentence, not their tracebacks
    }
    with dask.config.set(settings), _start(num_workers, memory_limit) as cluster, Client(cluster) as client:
        yield LocalWorkers(client, num_workers, lambda: list(cluster.workers.values()))


def _start(num_workers: int, memory_limit: str) -> Any:
    """Start the cluster, again where a worker is killed before it has begun to work: nobody revives it so early."""
    from distributed import LocalCluster

    # A busy machine, which Dask takes for a network file system: nothing that anybody could mend.
    warnings.filterwarnings("ignore", message="Creating scratch directories")
    for attempt in range(_MAX_STARTS):
        try:
            with _interrupts_held_back():
                return LocalCluster(
                    n_workers=num_workers,
                    threads_per_worker=1,
                    processes=True,
                    host="127.0.0.1",
                    dashboard_address="127.0.0.1:0",  # None would warn of a taken port when another run is under way
                    scheduler_kwargs={"dashboard": False},
                    memory_limit=memory_limit,
                    silence_logs=logging.CRITICAL,
                )
        except RuntimeError as error:
            if attempt == _MAX_STARTS - 1:
                raise UserError(f"the worker processes do not start ({error}); executor=serial needs none") from error
    raise AssertionError("the last attempt returns or raises")


@contextmanager
def _interrupts_held_back() -> Iterator[None]:
    """Keep Ctrl-C for this process: threads and processes that are started meanwhile never see it.

    A terminal sends it to the workers too, and each would print a traceback.
    """
    resource_tracker.ensure_running()  # it would lift the block if it were started later
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
