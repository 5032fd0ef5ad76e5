"""Show how far a run is: bars in a terminal, plain lines elsewhere."""

import time
from collections.abc import Iterable
from types import TracebackType

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TaskID, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.progress import Progress as Bars
from rich.progress import Task as RichTask

from pipeline.graph import Node
from pipeline.tasks import Result
from pipeline.terminal import say
from pipeline.work import Handle, SequenceWork

_SECONDS_BETWEEN_LINES = 5.0


class Progress:
    """Counts shards and frames by node, over all sequences."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._started = time.monotonic()
        self._last_line = self._started
        self._rows: dict[str, TaskID] = {}
        self._expected: dict[tuple[str, str], int] = {}
        self._bars = Bars(
            TextColumn("{task.description:>17}"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("{task.fields[rate]}"),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            console=console,
            disable=not console.is_terminal,
        )

    def __enter__(self) -> "Progress":
        self._bars.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bars.stop()

    def expect(self, work: SequenceWork, node: Node, num_shards: int, settled: Iterable[Handle]) -> None:
        """Note that a node of a sequence has so many shards, some of which are settled already."""
        place = (work.recording.sequence_id, node.name)
        if place in self._expected:
            return
        self._expected[place] = num_shards
        if node.name not in self._rows:
            self._rows[node.name] = self._bars.add_task(node.name, total=0, rate="", frames=0, busy_s=0.0)
        row = self._row(node.name)
        num_settled = sum(isinstance(handle, Result) for handle in settled)
        self._bars.update(row.id, total=(row.total or 0) + num_shards, advance=num_settled)

    def note(self, work: SequenceWork, result: Result) -> None:
        """Show that a shard has come to its end."""
        row = self._row(result.node)
        frames = row.fields["frames"] + (
            work.num_frames(work.config.dag.nodes[result.node], result.shard) if result.status == "done" else 0
        )
        elapsed = time.monotonic() - self._started
        rate = f"{frames / elapsed:.1f} frames/s" if frames else ""
        self._bars.update(row.id, advance=1, frames=frames, rate=rate)
        if result.status == "failed":
            say(self._console, f"failed: {result.node} {result.shard}: {result.error}")
        if not self._console.is_terminal:
            self._print_line(result.node, elapsed)

    def _row(self, node: str) -> "RichTask":
        return next(task for task in self._bars.tasks if task.id == self._rows[node])

    def _print_line(self, node: str, elapsed: float) -> None:
        row = self._row(node)
        is_last = row.completed == row.total
        if not is_last and time.monotonic() - self._last_line < _SECONDS_BETWEEN_LINES:
            return
        self._last_line = time.monotonic()
        left = sum((task.total or 0) - task.completed for task in self._bars.tasks)
        done = sum(task.completed for task in self._bars.tasks)
        eta = f", about {elapsed * left / done:.0f} s to go" if done and left else ""
        rate = f", {row.fields['rate']}" if row.fields["rate"] else ""
        say(self._console, f"{node}: {row.completed:.0f}/{row.total:.0f} shards{rate}{eta}")
