"""A sequence's share of a run, and the set's: tasks node by node, and the handles of those already under way."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from assemblyhands_core.data.catalog import CHUNKS
from assemblyhands_core.data.store import Store
from pipeline.config import RunConfig, UserError
from pipeline.graph import MEMBER_EDGE, ORIGINS, Node
from pipeline.recordings import Recording
from pipeline.takes import OrderedTake
from pipeline.tasks import SET_NAME, Result, Shard, Task
from stages._contract import StageConfig
from stages._detector_config import DetectorConfig

Handle = Any  # a Result, or an executor's promise of one


@dataclass
class SequenceWork:
    """The tasks of one sequence.

    Attributes:
        nodes: those that run for a sequence or its chunks.
        origins: for each edge of `ORIGINS` that the nodes read, its rows.
        cuts: edge of chunks → frames in each chunk, once its node has told; none where that node failed.
        handles: node → shard → its result, or the promise of it.
        whole: the tasks of the set that this sequence belongs to; None where the run has none.
    """

    config: RunConfig
    recording: "Recording | OrderedTake | SequenceSet"
    origins: Mapping[str, Sequence[Mapping[str, Any]]]
    nodes: Sequence[Node]
    logs: Path
    num_threads: int = 1
    cuts: dict[str, list[int]] = field(default_factory=dict)
    handles: dict[str, dict[Shard, Handle]] = field(default_factory=dict)
    whole: "SetWork | None" = None
    _known_externals: dict[str, tuple[Mapping[str, str], str]] = field(default_factory=dict)

    def known_nodes(self) -> Iterator[Node]:
        """Yield the nodes whose shards are known by now."""
        yield from (node for node in self.nodes if self.knows(node))

    def knows(self, node: Node) -> bool:
        """Tell whether a node's shards, and those of all that it reads, are known."""
        return self._chunk_edges(node) <= set(self.cuts)

    def tasks(self, node: Node) -> list[Task]:
        """Return a known node's tasks."""
        return [self._task(node, shard) for shard in self.shards(node)]

    def shards(self, node: Node) -> list[Shard]:
        """Return a known node's shards; where cutting failed, one that stands for them all."""
        name = self.recording.sequence_id
        if node.shard == "sequence" or not self.cuts.get(node.chunk_edge):
            return [Shard(name)]
        return [Shard(name, chunk) for chunk in range(len(self.cuts[node.chunk_edge]))]

    def upstream(self, task: Task) -> dict[str, list[Handle]]:
        """Return the handles that a task reads from: its own chunk's, or all of them."""
        return {name: self._matching(name, task.shard) for name in task.node.upstream}

    def missing_upstream(self, task: Task) -> list[str]:
        """Return the nodes that a task reads from and of which not all that it needs is under way or settled."""
        return [name for name in task.node.upstream if not self._has(name, task)]

    def num_frames(self, node: Node, shard: Shard) -> int:
        """Return the number of frames that a shard of a node covers, 0 while unknown."""
        frames = self.cuts.get(node.chunk_edge, [])
        return sum(frames) if shard.chunk is None else frames[shard.chunk]

    def settle(self, result: Result, store: Store) -> bool:
        """Note a result; return whether it told how the sequence is cut.

        Raises:
            DamagedEntry: if it should have told, but its table is damaged or gone; the result is not noted then.
        """
        node = self.config.dag.nodes[result.node]
        frames: list[int] = []
        if node.cut and result.has_entry:
            record = store.await_entry(node.stage.name, result.key)
            frames = store.read(record, node.cut, CHUNKS).column("num_frames").to_pylist()
        if node.cut:
            self.cuts[f"{node.name}.{node.cut}"] = frames
        self.handles.setdefault(result.node, {})[result.shard] = result
        return bool(node.cut)

    def _chunk_edges(self, node: Node) -> set[str]:
        """Return the edges that have to tell their chunks before a node's shards, and what it reads, are known."""
        if node.shard == "chunk":
            return {node.chunk_edge}
        upstream = [self.config.dag.nodes[name] for name in node.upstream]
        return {edge for other in upstream for edge in self._chunk_edges(other)}

    def _matching(self, name: str, shard: Shard) -> list[Handle]:
        if self._is_of_set(name):
            return self._set_handles(name)
        handles, whole = self.handles[name], Shard(shard.sequence_id)
        if shard.chunk is None:
            return [handles[key] for key in sorted(handles)]  # not in the order in which they were found or submitted
        return [handles[shard if shard in handles else whole]]

    def _has(self, name: str, task: Task) -> bool:
        if self._is_of_set(name):
            return bool(self._set_handles(name))
        upstream_node, there = self.config.dag.nodes[name], self.handles.get(name, {})
        is_alike = upstream_node.shard == task.node.shard
        return all(shard in there for shard in ([task.shard] if is_alike else self.shards(upstream_node)))

    def _is_of_set(self, name: str) -> bool:
        return self.config.dag.nodes[name].shard == "set"

    def _set_handles(self, name: str) -> list[Handle]:
        return list(self.whole.handles.get(name, {}).values()) if self.whole else []

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


@dataclass(frozen=True)
class SequenceSet:
    """The set of all sequences of a run, in the place of a recording."""

    sequence_id: str = SET_NAME
    keypoints: None = None
    detector: str = ""


@dataclass
class SetWork(SequenceWork):
    """The tasks that are about all sequences of a run together, such as a training.

    Attributes:
        members: the work of every sequence, by name.
    """

    members: Sequence[SequenceWork] = ()

    def known_nodes(self) -> Iterator[Node]:
        """Yield the nodes of which every sequence knows the shards that they read."""
        for node in self.nodes:
            if all(member.knows(own) for member in self.members for own in self._read_nodes(member, node)):
                yield node

    def shards(self, node: Node) -> list[Shard]:
        """Return the one shard that all sequences are."""
        return [Shard(self.recording.sequence_id)]

    def settle(self, result: Result, store: Store) -> bool:
        """Note a result, which tells nothing about shards."""
        self.handles.setdefault(result.node, {})[result.shard] = result
        return False

    def _matching(self, name: str, shard: Shard) -> list[Handle]:
        if self._is_of_set(name):
            return list(self.handles[name].values())
        parts = [member.handles[name] for member in self._members_with(name)]
        return [handles[key] for handles in parts for key in sorted(handles)]

    def _has(self, name: str, task: Task) -> bool:
        if self._is_of_set(name):
            return bool(self.handles.get(name))
        node = self.config.dag.nodes[name]
        return all(set(m.shards(node)) <= set(m.handles.get(name, {})) for m in self._members_with(name))

    def _members_with(self, name: str) -> list[SequenceWork]:
        """Return the sequences that have a node; one without headset has no egocentric crops."""
        return [member for member in self.members if any(node.name == name for node in member.nodes)]

    def _needed_in_vain(self, node: Node) -> list[str]:
        """Return the nodes of sequences that a node of the set reads if no sequence has any of them."""
        needed = [name for name in node.upstream if not self._is_of_set(name)]
        return [] if any(self._members_with(name) for name in needed) else needed

    def _read_nodes(self, member: SequenceWork, node: Node) -> list[Node]:
        return [other for other in member.nodes if other.name in node.upstream]


def with_set(works: Sequence[SequenceWork], splits: Mapping[str, str]) -> list[SequenceWork]:
    """Return the works of sequences and, if a target needs any, of the set that they are, with the split of each.

    Nodes of the set that read what no sequence has are left out.

    Raises:
        UserError: Nothing is left then.
    """
    config, first = works[0].config, works[0]
    members = sorted(works, key=lambda work: work.recording.sequence_id)
    nodes = [node for node in config.dag.upto(config.wanted_nodes) if node.shard == "set"]
    if not nodes:
        return list(works)
    origins = {MEMBER_EDGE: member_rows(splits, splits)}
    whole = SetWork(config, SequenceSet(), origins, nodes, first.logs, first.num_threads, members=members)
    lacking = {node.name: needed for node in nodes if (needed := whole._needed_in_vain(node))}
    if len(lacking) == len(nodes) and not any(work.nodes for work in works):
        name, needed = next(iter(lacking.items()))
        raise UserError(f"no sequence of this run has {' or '.join(needed)}, which {name} needs")
    whole.nodes = [node for node in nodes if node.name not in lacking]
    for work in works:
        work.whole = whole
    return [*works, whole]


def member_rows(splits: Mapping[str, str], names: Iterable[str]) -> list[Mapping[str, str]]:
    """Return the `catalog.MEMBERS` rows of some sequences."""
    return [{"sequence_id": name, "split": splits[name]} for name in sorted(names)]


def possible_nodes(config: RunConfig, sequence_id: str, origins: Mapping[str, Sequence[Any]]) -> list[Node]:
    """Return the nodes that a sequence can have: without ground truth nothing is evaluated."""
    absent = [edge for edge, rows in origins.items() if not rows]
    nodes = config.dag.upto(config.wanted_nodes, absent)
    if not nodes:
        raise UserError(f"sequence {sequence_id} comes without {', '.join(absent)}, which target={config.target} needs")
    return [node for node in nodes if node.shard != "set"]
