"""What a DAG of stages is: nodes, the edges between them, what comes from outside, and the rules that it keeps to."""

import pickle
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, fields, replace
from functools import cached_property, lru_cache
from typing import Any, Final

from assemblyhands_core.data.catalog import CHUNKS, MEMBERS, SOURCES
from assemblyhands_core.data.studio_tables import CROP_ORDERS, TAKES
from assemblyhands_core.data.tables import TableSpec
from stages._contract import Sharding, Stage

SOURCE_EDGE: Final = "sources"  # the recording's own files, as the engine finds them
TAKE_EDGE: Final = "takes"  # what the studio is to record, as the manifest orders it
LABEL_EDGE: Final = "label_sources"  # what people annotated in the recording
MEMBER_EDGE: Final = "members"  # which sequences a run is about, and the split of each
JUDGED_EDGE: Final = "judged"  # there for a sequence that networks are judged by, not for one that they learn from
TRUTH_EDGE: Final = "truth"  # files of the recording's ground truth, which evaluation alone may read
ACTION_EDGE: Final = "action_sources"  # what is being done when, as a file of fine-grained labels says
EGO_EDGE: Final = "ego_sources"  # the headset's own files, so that the fixed cameras' results do not depend on them
CORRECTION_EDGE: Final = "correction_sources"  # which 2D keypoints people set by hand, as a file says
CROP_EDGE: Final = "crop_orders"  # which crops the studio is to draw for training, as the manifest orders it
ORIGINS: Final[Mapping[str, TableSpec]] = {
    SOURCE_EDGE: SOURCES,
    EGO_EDGE: SOURCES,
    LABEL_EDGE: SOURCES,
    ACTION_EDGE: SOURCES,
    CORRECTION_EDGE: SOURCES,
    MEMBER_EDGE: MEMBERS,
    JUDGED_EDGE: MEMBERS,
    TAKE_EDGE: TAKES,
    CROP_EDGE: CROP_ORDERS,
    TRUTH_EDGE: SOURCES,
}
"""Edges that come from outside, and their tables."""


@dataclass(frozen=True)
class Node:
    """A stage's place in the DAG: under which name it runs and which node's table fills each of its roles.

    Attributes:
        shard: how often it runs: what its stage says, or for the set of all sequences where a sequence would do.
        chunk_edge: the edge upstream whose table says into which chunks a sequence is cut; empty before it is cut.
    """

    name: str
    stage: Stage[Any]
    inputs: Mapping[str, str]
    upstream_stages: Mapping[str, str]
    shard: Sharding
    chunk_edge: str

    def __reduce__(self) -> tuple[Callable[[bytes], "Node"], tuple[bytes]]:
        """Pickle what was pickled before: every shard's task has its node, whose tables take half a millisecond."""
        return _unpickled, (self._pickled,)

    @cached_property
    def _pickled(self) -> bytes:
        return pickle.dumps({field.name: getattr(self, field.name) for field in fields(self)})

    @property
    def cut(self) -> str:
        """Return the output that cuts a sequence into chunks, empty if this node does not."""
        return next((name for name, spec in self.stage.outputs.items() if spec is CHUNKS), "")

    @property
    def upstream(self) -> tuple[str, ...]:
        """Return the nodes that this one reads from."""
        return tuple(self.upstream_stages)

    def lost_roles(self, nodes: Collection[str], edges: Collection[str]) -> frozenset[str]:
        """Return the roles that nothing fills without some nodes and some of `ORIGINS`."""
        lost = {role for role, edge in self.inputs.items() if edge in edges or edge.partition(".")[0] in nodes}
        return frozenset(lost)

    def without(self, roles: Collection[str]) -> "Node":
        """Return the node as it is where nothing fills some of its optional roles."""
        inputs = {role: edge for role, edge in self.inputs.items() if role not in roles}
        sources = {edge.partition(".")[0] for edge in inputs.values()}
        upstream = {name: stage for name, stage in self.upstream_stages.items() if name in sources}
        return replace(self, inputs=inputs, upstream_stages=upstream)


@lru_cache(maxsize=256)
def _unpickled(content: bytes) -> Node:
    """Return a node that was sent by whoever gives this process its tasks."""
    return Node(**pickle.loads(content))


class Dag:
    """Nodes in the order in which they were added; every edge points back."""

    def __init__(self) -> None:
        self.nodes: dict[str, Node] = {}
        self.targets: dict[str, tuple[str, ...]] = {}  # what a user asks for → the nodes that it stands for

    def add(self, name: str, stage: Stage[Any], **inputs: str) -> None:
        """Add a node; ``inputs`` maps each role of the stage to ``"node.output"`` or one of ``ORIGINS``.

        Optional roles may be left out.

        Raises:
            ValueError: on a repeated name, an unknown or missing role, a forward reference or the wrong table.
        """
        self._add(name, stage, inputs, stage.shard)

    def add_for_set(self, name: str, stage: Stage[Any], inputs: Mapping[str, str]) -> None:
        """Add a stage that is made for a sequence for the set of all: its tables are those of all sequences."""
        self._add(name, stage, inputs, "set")

    def _add(self, name: str, stage: Stage[Any], inputs: Mapping[str, str], shard: Sharding) -> None:
        if name in self.nodes:
            raise ValueError(f"node {name} is added twice")
        if not set(stage.inputs) - stage.optional <= set(inputs) <= set(stage.inputs):
            raise ValueError(
                f"node {name}: stage {stage.name} has the roles {sorted(stage.inputs)}, not {sorted(inputs)}"
            )
        for role, edge in inputs.items():
            self._check_edge(name, stage, role, edge)
        sources = {edge.split(".")[0] for edge in inputs.values() if edge not in ORIGINS}
        upstream = {source: self.nodes[source].stage.name for source in self.nodes if source in sources}
        chunk_edge = self._chunk_edge(stage, inputs, upstream)
        self._check_chunks(name, shard, chunk_edge, upstream)
        self.nodes[name] = Node(name, stage, inputs, upstream, shard, chunk_edge)

    def upto(self, targets: tuple[str, ...], absent: Collection[str] = ()) -> list[Node]:
        """Return the nodes that the targets need, in order; not those that an absent origin of ``ORIGINS`` leads to.

        Where it leads to optional roles alone, the nodes are there without these.
        """
        possible: dict[str, Node] = {}
        for node in self.nodes.values():
            lost = node.lost_roles(set(self.nodes) - set(possible), absent)
            if lost <= node.stage.optional or node.shard == "set":  # others may bring what a set needs
                possible[node.name] = node.without(lost & node.stage.optional)
        wanted = set(targets).intersection(possible)
        # What the set is about needs this sequence even where what follows from it is not possible here.
        wanted |= {name for name in _closure(self.nodes, set(targets)) if self.nodes[name].shard == "set"}
        wanted = _closure(possible, wanted)
        return [node for node in possible.values() if node.name in wanted]

    def reads(self, edge: str, targets: tuple[str, ...]) -> bool:
        """Tell whether targets start from one of `ORIGINS`."""
        return any(edge in node.inputs.values() for node in self.upto(targets))

    def _chunk_edge(self, stage: Stage[Any], inputs: Mapping[str, str], upstream: Mapping[str, str]) -> str:
        """Return the chunks that a node is told, or else those of the first node upstream that has any."""
        told = [edge for role, edge in inputs.items() if stage.inputs[role] is CHUNKS]
        nodes = [self.nodes[name] for name in upstream]
        found = [f"{n.name}.{n.cut}" if n.cut else n.chunk_edge for n in nodes if n.cut or n.chunk_edge]
        return next(iter([*told, *found]), "")

    def _check_chunks(self, name: str, shard: Sharding, chunk_edge: str, upstream: Mapping[str, str]) -> None:
        others = [self.nodes[other] for other in upstream if self.nodes[other].shard == "chunk"]
        odd = [other for other in others if shard == "chunk" and other.chunk_edge != chunk_edge]
        if odd:
            cuts = f"{chunk_edge}, {odd[0].name} by {odd[0].chunk_edge}"
            raise ValueError(f"node {name} is cut by {cuts}: their chunks do not belong together")

    def _check_edge(self, name: str, stage: Stage[Any], role: str, edge: str) -> None:
        wanted = stage.inputs[role]
        if edge in ORIGINS:
            found = ORIGINS[edge]
        else:
            source, _, output = edge.partition(".")
            if source not in self.nodes:
                raise ValueError(f"node {name}: role {role} reads {edge}, but no node {source} comes before it")
            outputs = self.nodes[source].stage.outputs
            if output not in outputs:
                raise ValueError(f"node {name}: role {role} reads {edge}, but {source} has only {', '.join(outputs)}")
            found = outputs[output]
        if found is not wanted:
            raise ValueError(f"node {name}: role {role} takes table {wanted.name}, {edge} is table {found.name}")


def _closure(nodes: dict[str, Node], targets: set[str]) -> set[str]:
    """Return targets and all nodes that lead to them, of those given, which stand in order."""
    wanted = targets.intersection(nodes)
    for node in reversed(nodes.values()):
        if node.name in wanted:
            wanted.update(set(node.upstream).intersection(nodes))
    return wanted
