"""The whole way of the data on one screen, and the rules that it keeps to."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any, Final

from assemblyhands_core.data.catalog import CHUNKS, MEMBERS, SOURCES
from assemblyhands_core.data.studio_tables import CROP_ORDERS, TAKES
from assemblyhands_core.data.tables import TableSpec
from stages import (
    annotate_round,
    audit_recording,
    crop_hands,
    deliver_recording,
    detect_hands,
    detect_keypoints,
    draw_body_views,
    draw_crops,
    draw_ego_sheet,
    draw_overlays,
    evaluate,
    evaluate_ego,
    film_take,
    ingest,
    ingest_ego,
    measure_quality,
    plan_crops,
    predict_ego,
    preview_recording,
    project_ego,
    read_labels,
    script_take,
    smooth_joints,
    start_from_truth,
    tabulate_ego,
    train_body_keypoints,
    train_keypoints,
    train_mvexonet,
    train_svegonet,
    triangulate,
    undistort,
    use_weights,
    write_ego_pictures,
)
from stages._contract import Sharding, Stage

SOURCE_EDGE: Final = "sources"  # the recording's own files, as the engine finds them
TAKE_EDGE: Final = "takes"  # what the studio is to record, as the manifest orders it
LABEL_EDGE: Final = "label_sources"  # what people annotated in the recording
MEMBER_EDGE: Final = "members"  # which sequences a run is about, and the split of each
TRUTH_EDGE: Final = "truth"  # files of the recording's ground truth, which evaluation alone may read
EGO_EDGE: Final = "ego_sources"  # the headset's own files, so that the fixed cameras' results do not depend on them
CROP_EDGE: Final = "crop_orders"  # which crops the studio is to draw for training, as the manifest orders it
ORIGINS: Final[Mapping[str, TableSpec]] = {
    SOURCE_EDGE: SOURCES,
    EGO_EDGE: SOURCES,
    LABEL_EDGE: SOURCES,
    MEMBER_EDGE: MEMBERS,
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

    @property
    def cut(self) -> str:
        """Return the output that cuts a sequence into chunks, empty if this node does not."""
        return next((name for name, spec in self.stage.outputs.items() if spec is CHUNKS), "")

    @property
    def upstream(self) -> tuple[str, ...]:
        """Return the nodes that this one reads from."""
        return tuple(self.upstream_stages)


class Dag:
    """Nodes in the order in which they were added; every edge points back."""

    def __init__(self) -> None:
        self.nodes: dict[str, Node] = {}
        self.targets: dict[str, tuple[str, ...]] = {}  # what a user asks for → the nodes that it stands for

    def add(self, name: str, stage: Stage[Any], **inputs: str) -> None:
        """Add a node; ``inputs`` maps each role of the stage to ``"node.output"`` or one of ``ORIGINS``.

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
        if set(inputs) != set(stage.inputs):
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
        """Return the nodes that the targets need, in order; not those that an absent origin of ``ORIGINS`` leads to."""
        impossible: set[str] = set()
        for node in self.nodes.values():
            is_without = impossible.intersection(node.upstream) or not set(absent).isdisjoint(node.inputs.values())
            if is_without and node.shard != "set":  # others may bring what a set needs
                impossible.add(node.name)
        wanted = set(targets) - impossible
        for node in reversed(self.nodes.values()):
            if node.name in wanted:
                wanted.update(set(node.upstream) - impossible)
        return [node for node in self.nodes.values() if node.name in wanted]

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


def build_dag(num_rounds: int = 3) -> Dag:
    """Return the whole pipeline; its annotation is that of the last round, 2D + triangulation without any."""
    dag = Dag()
    _add_studio(dag)
    _add_training(dag)
    _add_annotation(dag)
    _add_rounds(dag, num_rounds)
    _add_results(dag, f"round_{num_rounds}")
    _add_own_training(dag)
    _add_egocentric(dag, f"round_{num_rounds}")
    evaluations = _add_evaluation(dag, num_rounds)
    dag.targets |= {
        "annotate": ("quality", "overlay", *evaluations),
        "smooth": ("quality", "overlay", *evaluations, "smoothed", "evaluation_smoothed"),
        "evaluate": (*evaluations, "evaluation_bound"),
        "doctor": ("audit",),
        "undistort": ("undistort",),
        "ego": ("project_ego", "project_manual"),
        "export": (f"round_{num_rounds}", "ego_pictures"),
        "train_ego": ("svegonet_both", "ego_evaluation_both"),
        "cross": tuple(f"ego_evaluation_{labels}" for labels in ("manual", "automatic", "both")),
        "predict": ("predict_ego", "predict_manual", "ego_evaluation", "ego_sheet"),
        "simulate": ("delivery", "preview"),
        "training_data": ("training_crops", "body_views"),
        "train": ("body_weights", "keypoint_weights", "mvexonet_weights"),
        "train_own": ("own_keypoint_weights", "own_mvexonet_weights"),
    }
    return dag


def _add_studio(dag: Dag) -> None:
    """Add how a synthetic recording is made (docs/decisions/0006)."""
    dag.add("script", script_take.STAGE, takes=TAKE_EDGE)
    dag.add("film", film_take.STAGE, takes=TAKE_EDGE, chunks="script.chunks")
    dag.add(
        "delivery",
        deliver_recording.STAGE,
        takes=TAKE_EDGE,
        actions="script.actions",
        footage="film.footage",
        true_joints="film.true_joints",
        true_views="film.true_views",
        true_instants="film.true_instants",
    )
    dag.add("preview", preview_recording.STAGE, takes=TAKE_EDGE, footage="film.footage", true_views="film.true_views")


def _add_training(dag: Dag) -> None:
    """Add how networks are trained on crops (paper, Sec. 3.1)."""
    dag.add("crop_plan", plan_crops.STAGE, orders=CROP_EDGE)
    dag.add("training_crops", draw_crops.STAGE, orders=CROP_EDGE, chunks="crop_plan.chunks")
    crops = {
        "chunks": "crop_plan.chunks",
        "crops": "training_crops.crops",
        "labels": "training_crops.labels",
    }
    dag.add("body_views", draw_body_views.STAGE, orders=CROP_EDGE, chunks="crop_plan.chunks")
    dag.add("body_weights", train_body_keypoints.STAGE, chunks="crop_plan.chunks", labels="body_views.labels")
    dag.add("keypoint_weights", train_keypoints.STAGE, **crops)
    dag.add("mvexonet_weights", train_mvexonet.STAGE, **crops, start="keypoint_weights.weights")


def _add_annotation(dag: Dag) -> None:
    """Add how videos become 3D joints (paper, Sec. 3.1 and supplement B)."""
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


def _add_rounds(dag: Dag, num_rounds: int) -> None:
    """Add how the joints of a round are the boxes and the root of the next one; the network stays the same.

    With the round before that a hand that stands still can be told; round 1 knows of none and takes the same one twice.
    Round 1 is there even where none is wanted, so that the parameters of its stage are known.
    """
    for number in range(1, max(num_rounds, 1) + 1):
        _add_round(dag, f"round_{number}", "round_0", f"round_{number - 1}", f"round_{max(number - 2, 0)}")


def _add_round(dag: Dag, name: str, first: str, before: str, earlier: str) -> None:
    dag.add(
        name,
        annotate_round.STAGE,
        views="ingest.views",
        rectified_views="undistort.rectified_views",
        hand_boxes="detect_hands.hand_boxes",
        crops="crop_hands.crops",
        keypoints="detect_keypoints.keypoints",
        triangulated=f"{first}.joints",
        joints=f"{before}.joints",
        earlier_joints=f"{earlier}.joints",
    )


def _add_results(dag: Dag, last: str) -> None:
    """Add what shows an annotation: how good it is, and pictures; beside it the same cleaned up over time."""
    dag.add(
        "quality",
        measure_quality.STAGE,
        views="ingest.views",
        body_keypoints="detect_hands.body_keypoints",
        bodies="detect_hands.bodies",
        joints=f"{last}.joints",
        triangulated="round_0.joints",
        residuals="round_0.residuals",
    )
    dag.add(
        "overlay",
        draw_overlays.STAGE,
        views="ingest.views",
        body_keypoints="detect_hands.body_keypoints",
        joints=f"{last}.joints",
    )
    dag.add("smoothed", smooth_joints.STAGE, joints=f"{last}.joints")


def _add_own_training(dag: Dag) -> None:
    """Add how networks are trained on recordings that people annotated, all of a run together."""
    dag.add("labels", read_labels.STAGE, sources=LABEL_EDGE, views="ingest.views")
    for name, stage, start in (
        ("own_keypoint_weights", train_keypoints.STAGE, {}),
        ("own_mvexonet_weights", train_mvexonet.STAGE, {"start": "own_keypoint_weights.weights"}),
    ):
        data = {"chunks": "ingest.chunks", "crops": "crop_hands.crops", "labels": "labels.labels", **start}
        dag.add_for_set(name, stage, data)


def _add_egocentric(dag: Dag, last: str) -> None:
    """Add how an annotation becomes crops of the headset's pictures (paper, Sec. 4)."""
    dag.add("ingest_ego", ingest_ego.STAGE, sources=EGO_EDGE)
    dag.add("undistort_ego", undistort.STAGE, views="ingest_ego.views")
    headset = {
        "views": "ingest_ego.views",
        "rectified_views": "undistort_ego.rectified_views",
        "frames": "ingest_ego.frames",
        "boxes": "ingest_ego.boxes",
    }
    automatic = {**headset, "chunks": "ingest.chunks", "joints": f"{last}.joints"}
    manual = {**headset, "chunks": "ingest_ego.chunks", "joints": "ingest_ego.joints"}  # nothing of fixed cameras
    dag.add("project_ego", project_ego.STAGE, **automatic)
    dag.add("project_manual", project_ego.STAGE, **manual)
    dag.add("ego_pictures", write_ego_pictures.STAGE, **automatic)
    dag.add("svegonet", use_weights.STAGE)
    _add_prediction(dag, "", "svegonet.weights")
    seen = {"views": "ingest.views", "crops": "project_ego.crops", "hands": "predict_ego.hands"}
    dag.add("ego_sheet", draw_ego_sheet.STAGE, **seen)
    crops = {"members": MEMBER_EDGE, "manual": "project_manual.crops", "automatic": "project_ego.crops"}
    for name, stage in (
        ("manual", train_svegonet.ON_MANUAL),
        ("automatic", train_svegonet.ON_AUTOMATIC),
        ("both", train_svegonet.STAGE),
    ):
        dag.add(f"svegonet_{name}", stage, **{role: crops[role] for role in stage.inputs})
        _add_prediction(dag, f"_{name}", f"svegonet_{name}.weights")


def _add_prediction(dag: Dag, suffix: str, weights: str) -> None:
    """Add how an egocentric network is used, and held against both kinds of labels."""
    for name in ("ego", "manual"):
        crops = f"project_{name}.crops"
        dag.add(f"predict_{name}{suffix}", predict_ego.STAGE, crops=crops, weights=weights)
        dag.add(f"errors_{name}{suffix}", evaluate_ego.STAGE, crops=crops, hands=f"predict_{name}{suffix}.hands")
    errors = {"manual": f"errors_manual{suffix}.errors", "automatic": f"errors_ego{suffix}.errors"}
    dag.add(f"ego_evaluation{suffix}", tabulate_ego.STAGE, members=MEMBER_EDGE, **errors)


def _add_evaluation(dag: Dag, num_rounds: int) -> tuple[str, ...]:
    """Add how each round is held against the truth, on its own, so that a further round leaves the others' figures.

    Beside them the upper bound: a round that starts from the truth, which nothing but its own evaluation reads.
    """
    dag.add("true_start", start_from_truth.STAGE, truth=TRUTH_EDGE, chunks="ingest.chunks")
    _add_round(dag, "upper_bound", "round_0", *["true_start"] * 2)
    _add_one_evaluation(dag, "evaluation_bound", "upper_bound")
    _add_one_evaluation(dag, "evaluation_smoothed", "smoothed")
    names = tuple(f"evaluation_{number}" for number in range(num_rounds + 1))
    for number, name in enumerate(names):
        _add_one_evaluation(dag, name, f"round_{number}")
    return names


def _add_one_evaluation(dag: Dag, name: str, judged: str) -> None:
    dag.add(name, evaluate.STAGE, chunks="ingest.chunks", truth=TRUTH_EDGE, joints=f"{judged}.joints")


LOOKING_TARGETS: Final = frozenset({"doctor"})
"""They make nothing that anyone would go on with."""
