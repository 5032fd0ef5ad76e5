"""The whole way of the data."""

from typing import Any, Final

from pipeline.graph import (
    ACTION_EDGE,
    CORRECTION_EDGE,
    CROP_EDGE,
    EGO_EDGE,
    JUDGED_EDGE,
    LABEL_EDGE,
    MEMBER_EDGE,
    SOURCE_EDGE,
    TAKE_EDGE,
    TRUTH_EDGE,
    Dag,
)
from stages import (
    annotate_round,
    audit_recording,
    classify_verbs,
    crop_hands,
    cut_verb_clips,
    deliver_recording,
    detect_hands,
    detect_keypoints,
    draw_body_views,
    draw_crops,
    draw_ego_crops,
    draw_ego_sheet,
    draw_overlays,
    draw_verb_clips,
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
    read_corrections,
    read_labels,
    script_take,
    smooth_joints,
    start_from_truth,
    tabulate_ego,
    tabulate_verbs,
    train_body_keypoints,
    train_keypoints,
    train_mvexonet,
    train_svegonet,
    train_verbs,
    triangulate,
    triangulate_ego,
    undistort,
    use_msg3d,
    use_svegonet,
    write_ego_pictures,
)
from stages._contract import Stage

_EGO_NETWORKS: Final = ("manual", "automatic", "both")
"""By which labels they learn: people's, ours, or either (paper, Table 4)."""


def build_dag(num_rounds: int = 3, is_ego_trained: bool = False) -> Dag:
    """Return the whole pipeline; its annotation is that of the last round, 2D + triangulation without any.

    Args:
        num_rounds: How often the annotation is refined.
        is_ego_trained: Whether hands in the headset's pictures are found by the SVEgoNet that the run itself trains on
            all its labels, instead of the shipped one.
    """
    dag = Dag()
    _add_studio(dag)
    _add_training(dag)
    _add_annotation(dag)
    _add_rounds(dag, num_rounds)
    _add_results(dag, f"round_{num_rounds}")
    _add_own_training(dag)
    judged_ego = _add_egocentric(dag, f"round_{num_rounds}", is_ego_trained)
    evaluations = _add_evaluation(dag, num_rounds)
    _add_verbs(dag, f"round_{num_rounds}")
    dag.targets |= {
        "annotate": ("quality", "overlay", *evaluations),
        "smooth": ("quality", "overlay", *evaluations, "smoothed", "evaluation_smoothed"),
        "evaluate": (*evaluations, "evaluation_bound"),
        "doctor": ("audit",),
        "undistort": ("undistort",),
        "ego": ("project_ego", "project_manual"),
        "export": (f"round_{num_rounds}", "ego_pictures"),
        "ego_weights": ("drawn_svegonet",),
        "train_ego": ("svegonet_both", "ego_evaluation_both"),
        "cross": tuple(f"{node}_{labels}" for labels in _EGO_NETWORKS for node in ("svegonet", "ego_evaluation")),
        "predict": ("predict_ego", "predict_manual", judged_ego, "ego_sheet"),
        "label_quality": tuple(
            f"{node}_{labels}" for labels in ("automatic", "tracked") for node in ("svegonet", "ego_evaluation")
        ),
        "ego_only": ("evaluation_ego_only", "evaluation_ego_only_manual"),
        "verbs": ("verb_table", "verb_table_manual"),
        "train_verbs": ("own_verb_table", "own_verb_table_manual"),
        "all": (
            *("quality", "overlay", *evaluations, "evaluation_bound"),
            *("svegonet_both", "ego_evaluation_both", judged_ego, "ego_sheet"),
            *("evaluation_ego_only", "evaluation_ego_only_manual"),
            *("verb_table", "verb_table_manual", "own_verb_table", "own_verb_table_manual"),
        ),
        "verb_weights": ("drawn_verb_weights", "drawn_verbs"),
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
    dag.add(
        "corrections",
        read_corrections.STAGE,
        sources=CORRECTION_EDGE,
        chunks="ingest.chunks",
        views="ingest.views",
    )
    dag.add(
        "round_0",
        triangulate.STAGE,
        views="ingest.views",
        keypoints="detect_keypoints.keypoints",
        corrections="corrections.corrections",
    )


def _add_rounds(dag: Dag, num_rounds: int) -> None:
    """Add how the joints of a round are the boxes and the root of the next one; the network stays the same.

    With the round before that a hand that stands still can be told; round 1 knows of none and takes the same one twice.
    Round 1 is there even where none is wanted, so that the parameters of its stage are known.
    """
    for number in range(1, max(num_rounds, 1) + 1):
        joints = "round_0", f"round_{number - 1}", f"round_{max(number - 2, 0)}"
        _add_round(dag, f"round_{number}", *joints, corrections="corrections.corrections")


def _add_round(dag: Dag, name: str, first: str, before: str, earlier: str, **more: str) -> None:
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
        **more,
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


def _add_egocentric(dag: Dag, last: str, is_trained: bool) -> str:
    """Add how an annotation becomes crops of the headset's pictures (paper, Sec. 4); return what judges the network."""
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
    for suffix, found, cut_by in (("", "ego", "ingest"), ("_manual", "manual", "ingest_ego")):
        dag.add(f"ego_only{suffix}", triangulate_ego.STAGE, crops=f"project_{found}.crops")
        _add_one_evaluation(dag, f"evaluation_ego_only{suffix}", f"ego_only{suffix}", cut_by)
    dag.add("project_tracked", project_ego.STAGE, **{**automatic, "joints": "ego_only.joints"})
    drawn = {"orders": CROP_EDGE, "chunks": "crop_plan.chunks"}
    dag.add("drawn_ego_crops", draw_ego_crops.STAGE, **drawn)
    on_drawn = {"members": MEMBER_EDGE, "automatic": "drawn_ego_crops.crops"}
    dag.add("drawn_svegonet", train_svegonet.ON_AUTOMATIC, **on_drawn)
    dag.add("svegonet", use_svegonet.STAGE)
    crops = {"members": MEMBER_EDGE, "manual": "project_manual.crops", "automatic": "project_ego.crops"}
    tracked = {**crops, "automatic": "project_tracked.crops"}
    for name, stage, labelled in (
        ("manual", train_svegonet.ON_MANUAL, crops),
        ("automatic", train_svegonet.ON_AUTOMATIC, crops),
        ("both", train_svegonet.STAGE, crops),
        ("tracked", train_svegonet.ON_AUTOMATIC, tracked),
    ):
        dag.add(f"svegonet_{name}", stage, **{role: labelled[role] for role in stage.inputs})
        _add_prediction(dag, f"_{name}", f"svegonet_{name}.weights", evaluate_ego.OF_JUDGED)
    if is_trained:
        _add_prediction(dag, "", "svegonet_both.weights")
    else:
        _add_prediction(dag, "", "svegonet.weights", evaluate_ego.STAGE)
    seen = {"views": "ingest.views", "crops": "project_ego.crops", "hands": "predict_ego.hands"}
    dag.add("ego_sheet", draw_ego_sheet.STAGE, **seen)
    return "ego_evaluation_both" if is_trained else "ego_evaluation"


def _add_prediction(dag: Dag, suffix: str, weights: str, evaluation: Stage[Any] | None = None) -> None:
    """Add how an egocentric network is used and, with an evaluation, held against both kinds of labels."""
    names = "ego", "manual"
    for name in names:
        dag.add(f"predict_{name}{suffix}", predict_ego.STAGE, crops=f"project_{name}.crops", weights=weights)
    if evaluation is None:
        return
    judged = {"judged": JUDGED_EDGE} if "judged" in evaluation.inputs else {}
    for name in names:
        found = {"crops": f"project_{name}.crops", "hands": f"predict_{name}{suffix}.hands"}
        dag.add(f"errors_{name}{suffix}", evaluation, **found, **judged)
    errors = {"manual": f"errors_manual{suffix}.errors", "automatic": f"errors_ego{suffix}.errors"}
    dag.add(f"ego_evaluation{suffix}", tabulate_ego.STAGE, members=MEMBER_EDGE, **errors)


def _add_verbs(dag: Dag, last: str) -> None:
    """Add how verbs are told from poses (paper, Sec. 5), by our labels or people's: each source of poses has its part.

    The shipped network was trained on poses that the studio drew, the `own_` ones on the source that they are for.
    """
    drawn = {"orders": CROP_EDGE, "chunks": "crop_plan.chunks"}
    dag.add("drawn_verb_clips", draw_verb_clips.STAGE, **drawn)
    dag.add("drawn_verb_weights", train_verbs.STAGE, members=MEMBER_EDGE, clips="drawn_verb_clips.clips")
    _add_classification(dag, "drawn_verbs", "drawn_verb_clips", "drawn_verb_clips", "drawn_verb_weights")
    dag.add("msg3d", use_msg3d.STAGE)
    for suffix, views, annotation, found in (
        ("", "ingest.views", f"{last}.joints", "ego"),
        ("_manual", "ingest_ego.views", "ingest_ego.joints", "manual"),
    ):
        poses = {
            "annotation": annotation,
            "svegonet": f"predict_{found}.joints",
            "ego_only": f"ego_only{suffix}.joints",
        }
        for source, joints in poses.items():
            name = f"{source}{suffix}"
            dag.add(f"clips_{name}", cut_verb_clips.STAGE, actions=ACTION_EDGE, views=views, joints=joints)
            dag.add(f"msg3d_{name}", train_verbs.STAGE, members=MEMBER_EDGE, clips=f"clips_{name}.clips")
            for begin, network in (("", "msg3d"), ("own_", f"msg3d_{name}")):
                _add_classification(dag, f"{begin}verbs_{name}", f"clips_{name}", f"clips_annotation{suffix}", network)
        for begin in ("", "own_"):
            found_verbs = {source: f"{begin}verbs_{source}{suffix}.predictions" for source in poses}
            dag.add(f"{begin}verb_table{suffix}", tabulate_verbs.STAGE, members=MEMBER_EDGE, **found_verbs)


def _add_classification(dag: Dag, name: str, clips: str, reference: str, network: str) -> None:
    tables = {"clips": f"{clips}.clips", "reference": f"{reference}.clips", "weights": f"{network}.weights"}
    dag.add(name, classify_verbs.STAGE, **tables)


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


def _add_one_evaluation(dag: Dag, name: str, judged: str, cut_by: str = "ingest") -> None:
    dag.add(name, evaluate.STAGE, chunks=f"{cut_by}.chunks", truth=TRUTH_EDGE, joints=f"{judged}.joints")


LOOKING_TARGETS: Final = frozenset({"doctor"})
"""They make nothing that anyone would go on with."""
