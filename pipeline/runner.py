"""Execute a plan: submit what is missing as soon as it is known, take results as they come."""

from collections.abc import Sequence
from dataclasses import dataclass

from assemblyhands_core.data.store import DamagedEntry, Store
from pipeline.executors import Executor
from pipeline.progress import Progress
from pipeline.tasks import Result
from pipeline.work import SequenceWork, SetWork


@dataclass
class Runner:
    """Runs the tasks of all sequences side by side; there is no barrier between nodes or sequences."""

    works: Sequence[SequenceWork]
    executor: Executor
    store: Store
    progress: Progress

    def run(self) -> None:
        """Run until every task of every sequence has a result in its work's handles."""
        by_name = {work.recording.sequence_id: work for work in self.works}
        self._submit_from(self._sequences)
        for result in self.executor.completed():
            self._settle(by_name[result.shard.sequence_id], result)

    def _settle(self, work: SequenceWork, result: Result) -> None:
        """Note a result, and submit what is known by it; one whose tables cannot be read here is no result."""
        try:
            is_cut = work.settle(result, self.store)
        except (DamagedEntry, OSError) as error:
            is_damaged = isinstance(error, DamagedEntry)
            result = Result(result.node, result.shard, "failed", error=str(error), is_repairable=is_damaged)
            is_cut = work.settle(result, self.store)
        self.progress.note(work, result)
        if is_cut:
            self._submit_from([work])

    def _submit_from(self, works: Sequence[SequenceWork]) -> None:
        """Submit what can be of some sequences, then of the set, which may let more of all of them follow."""
        for work in works:
            self._submit_of(work)
        if any(self._submit_of(work) for work in self.works if isinstance(work, SetWork)):
            self._submit_from(self._sequences)

    @property
    def _sequences(self) -> list[SequenceWork]:
        return [work for work in self.works if not isinstance(work, SetWork)]

    def _submit_of(self, work: SequenceWork) -> bool:
        """Submit what can be of a work; return whether that was anything."""
        num_submitted = 0
        for node in work.known_nodes():
            under_way = work.handles.setdefault(node.name, {})
            tasks = work.tasks(node)
            self.progress.expect(work, node, len(tasks), under_way.values())
            for task in tasks:
                if task.shard not in under_way and not work.missing_upstream(task):
                    under_way[task.shard] = self.executor.submit(task, work.upstream(task))
                    num_submitted += 1
        return num_submitted > 0


def results(works: Sequence[SequenceWork]) -> list[Result]:
    """Return the results of all shards, in the order of sequences and nodes."""
    handles = [work.handles.get(node.name, {}) for work in works for node in work.nodes]
    return [handle for shards in handles for handle in shards.values() if isinstance(handle, Result)]
