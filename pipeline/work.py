"""One sequence's share of a run: its tasks node by node, and the handles of those already under way."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from assemblyhands_core.data.catalog import CHUNKS
from assemblyhands_core.data.store import DamagedEntry, Store
from pipeline.config import RunConfig, UserError
from pipeline.dag import ORIGINS, Node
from pipeline.recordings import Recording
from pipeline.takes import OrderedTake
from pipeline.tasks import Result, Shard, Task
from stages._contract import StageConfig
from stages._detector_config import DetectorConfig

Handle = Any  # a Result, or an executor's promise of one


@dataclass
class SequenceWork:
    """The tasks of one sequence.

    Attributes:
        origins: for each edge of `ORIGINS` that the nodes read, its rows.
        chunk_frames: frames in each chunk, once ingest has told; None before.
        is_cut: whether ingest has told or failed, so that every shard is known.
        handles: node → shard → its result, or the promise of it.
    """

    config: RunConfig
    recording: Recording | OrderedTake
    origins: Mapping[str, Sequence[Mapping[str, Any]]]
    nodes: Sequence[Node]
    logs: Path
    num_threads: int = 1
    chunk_frames: list[int] | None = None
    is_cut: bool = False
    handles: dict[str, dict[Shard, Handle]] = field(default_factory=dict)
    _known_externals: dict[str, tuple[Mapping[str, str], str]] = field(default_factory=dict)

    def known_nodes(self) -> Iterator[Node]:
        """Yield the nodes whose shards are known by now."""
        for node in self.nodes:
            if self.is_cut or (node.stage.shard == "sequence" and not self._waits_for_chunks(node)):
                yield node

    def tasks(self, node: Node) -> list[Task]:
        """Return a known node's tasks."""
        return [self._task(node, shard) for shard in self.shards(node)]

    def shards(self, node: Node) -> list[Shard]:
        """Return a known node's shards; where cutting failed, one that stands for them all."""
        name = self.recording.sequence_id
        if node.stage.shard == "sequence" or self.chunk_frames is None:
            return [Shard(name)]
        return [Shard(name, chunk) for chunk in range(len(self.chunk_frames))]

    def upstream(self, task: Task) -> dict[str, list[Handle]]:
        """Return the handles that a task reads from: its own chunk's, or all of them."""
        return {name: self._matching(self.handles[name], task.shard) for name in task.node.upstream}

    def num_frames(self, shard: Shard) -> int:
        """Return the number of frames that a shard covers, 0 while unknown."""
        frames = self.chunk_frames or []
        return sum(frames) if shard.chunk is None else frames[shard.chunk]

    def settle(self, result: Result, store: Store) -> bool:
        """Note a result; return whether it told how the sequence is cut.

        Raises:
            DamagedEntry: if it should have told, but its table is damaged; the result is not noted then.
        """
        node = self.config.dag.nodes[result.node]
        if node.cut and result.has_entry:
            record = store.find(node.stage.name, result.key)
            if record is None:
                raise DamagedEntry(f"the entry {result.key} of {node.name} has vanished; run again")
            self.chunk_frames = store.read(record, node.cut, CHUNKS).column("num_frames").to_pylist()
        self.handles.setdefault(result.node, {})[result.shard] = result
        self.is_cut = self.is_cut or bool(node.cut)
        return bool(node.cut)

    def _waits_for_chunks(self, node: Node) -> bool:
        upstream = [self.config.dag.nodes[name] for name in node.upstream]
        return any(other.stage.shard == "chunk" or self._waits_for_chunks(other) for other in upstream)

    def _matching(self, handles: Mapping[Shard, Handle], shard: Shard) -> list[Handle]:
        whole = Shard(shard.sequence_id)
        if shard.chunk is None:
            return [handles[key] for key in sorted(handles)]  # not in the order in which they were found or submitted
        return [handles[shard if shard in handles else whole]]

    def _task(self, node: Node, shard: Shard) -> Task:
        config = self._stage_config(node)
        log = self.logs / f"{node.name}-{shard}.log"
        externals, problem = self._externals(node, config)
        origins = {edge: self.origins[edge] for edge in node.inputs.values() if edge in ORIGINS}
        return Task(node, shard, config, externals, problem, origins, self.config.workspace, log, self.num_threads)

    def _stage_config(self, node: Node) -> StageConfig:
        config = self.config.stages[node.stage.name]
        if isinstance(config, DetectorConfig):
            return config.resolved(self.recording.keypoints, self.recording.detector)
        return config

    def _externals(self, node: Node, config: StageConfig) -> tuple[Mapping[str, str], str]:
        """Return a node's externals and what is wrong with them; asked once, as digesting files takes time."""
        if node.name not in self._known_externals:
            try:
                found = node.stage.externals(config, self.recording.sequence_id), ""
            except (ValueError, OSError) as error:
                found = {}, str(error)
            self._known_externals[node.name] = found
        return self._known_externals[node.name]


def possible_nodes(config: RunConfig, sequence_id: str, origins: Mapping[str, Sequence[Any]]) -> list[Node]:
    """Return the nodes that a sequence can have: without ground truth nothing is evaluated."""
    absent = [edge for edge, rows in origins.items() if not rows]
    nodes = config.dag.upto(config.wanted_nodes, absent)
    if not nodes:
        raise UserError(f"sequence {sequence_id} comes without {', '.join(absent)}, which target={config.target} needs")
    return nodes
