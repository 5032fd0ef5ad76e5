"""The whole way of the data on one screen, and the rules that it keeps to."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

from assemblyhands_core.data.catalog import CHUNKS, SOURCES
from stages import (
    audit_recording,
    crop_hands,
    detect_hands,
    detect_keypoints,
    draw_overlays,
    ingest,
    measure_quality,
    triangulate,
    undistort,
)
from stages._contract import Stage

SOURCE_EDGE: Final = "sources"  # the recording's own files, as the engine finds them


@dataclass(frozen=True)
class Node:
    """A stage's place in the DAG: under which name it runs and which node's table fills each of its roles."""

    name: str
    stage: Stage[Any]
    inputs: Mapping[str, str]
    upstream_stages: Mapping[str, str]
    chunk_edge: str

    @property
    def upstream(self) -> tuple[str, ...]:
        """Return the nodes that this one reads from."""
        return tuple(self.upstream_stages)


class Dag:
    """Nodes in the order in which they were added; every edge points back."""

    def __init__(self) -> None:
        self.nodes: dict[str, Node] = {}

    def add(self, name: str, stage: Stage[Any], **inputs: str) -> None:
        """Add a node; ``inputs`` maps each role of the stage to ``"node.output"`` or to ``SOURCE_EDGE``.

        Raises:
            ValueError: on a repeated name, an unknown or missing role, a forward reference or the wrong table.
        """
        if name in self.nodes:
            raise ValueError(f"node {name} is added twice")
        if set(inputs) != set(stage.inputs):
            raise ValueError(
                f"node {name}: stage {stage.name} has the roles {sorted(stage.inputs)}, not {sorted(inputs)}"
            )
        for role, edge in inputs.items():
            self._check_edge(name, stage, role, edge)
        sources = {edge.split(".")[0] for edge in inputs.values() if edge != SOURCE_EDGE}
        upstream = {source: self.nodes[source].stage.name for source in self.nodes if source in sources}
        self.nodes[name] = Node(name, stage, inputs, upstream, self.chunk_edge)

    @property
    def chunk_edge(self) -> str:
        """Return the edge whose table says into which chunks a sequence is cut."""
        edges = [f"{n.name}.{o}" for n in self.nodes.values() for o, spec in n.stage.outputs.items() if spec is CHUNKS]
        return edges[0] if edges else ""

    def upto(self, targets: tuple[str, ...]) -> list[Node]:
        """Return the nodes that the targets need, in order."""
        wanted = set(targets)
        for node in reversed(self.nodes.values()):
            if node.name in wanted:
                wanted.update(node.upstream)
        return [node for node in self.nodes.values() if node.name in wanted]

    def _check_edge(self, name: str, stage: Stage[Any], role: str, edge: str) -> None:
        wanted = stage.inputs[role]
        if edge == SOURCE_EDGE:
            found = SOURCES
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


def build_dag() -> Dag:
    """Return the pipeline (paper, Sec. 3.1 and supplement B)."""
    dag = Dag()
    dag.add("ingest", ingest.STAGE, sources=SOURCE_EDGE)
    dag.add("undistort", undistort.STAGE, views="ingest.views")
    dag.add("audit", audit_recording.STAGE, views="ingest.views")
    dag.add(
        "detect_hands",
        detect_hands.STAGE,
        chunks="ingest.chunks",
        views="ingest.views",
        rectified_views="undistort.rectified_views",
    )
    dag.add(
        "crop_hands",
        crop_hands.STAGE,
        chunks="ingest.chunks",
        views="ingest.views",
        rectified_views="undistort.rectified_views",
        hand_boxes="detect_hands.hand_boxes",
    )
    dag.add(
        "detect_keypoints",
        detect_keypoints.STAGE,
        views="ingest.views",
        crops="crop_hands.crops",
        body_keypoints="detect_hands.body_keypoints",
    )
    dag.add("round_0", triangulate.STAGE, views="ingest.views", keypoints="detect_keypoints.keypoints")
    dag.add(
        "quality",
        measure_quality.STAGE,
        views="ingest.views",
        body_keypoints="detect_hands.body_keypoints",
        bodies="detect_hands.bodies",
        joints="round_0.joints",
        residuals="round_0.residuals",
    )
    dag.add(
        "overlay",
        draw_overlays.STAGE,
        views="ingest.views",
        body_keypoints="detect_hands.body_keypoints",
        joints="round_0.joints",
    )
    return dag


TARGETS: Final[Mapping[str, tuple[str, ...]]] = {
    "annotate": ("quality", "overlay"),
    "doctor": ("audit",),
    "undistort": ("undistort",),
}
LOOKING_TARGETS: Final = frozenset({"doctor"})  # they make nothing that anyone would go on with
