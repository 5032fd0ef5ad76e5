"""How hands are labelled and found in the headset's pictures."""

from typing import Any, Final

from pipeline.evaluation_dag import add_evaluation
from pipeline.graph import CROP_EDGE, EGO_EDGE, JUDGED_EDGE, MEMBER_EDGE, Dag
from stages import (
    draw_ego_crops,
    draw_ego_sheet,
    evaluate_ego,
    ingest_ego,
    predict_ego,
    project_ego,
    tabulate_ego,
    train_svegonet,
    triangulate_ego,
    undistort,
    use_svegonet,
    write_ego_pictures,
)
from stages._contract import Stage

ALL_LABELS: Final = "both"
EGO_NETWORKS: Final = ("manual", "automatic", ALL_LABELS)
"""By which labels they learn: people's, ours, or either (paper, Table 4)."""


def add_egocentric(dag: Dag, last: str, is_trained: bool) -> str:
    """Add how an annotation becomes crops of the headset's pictures, and networks learn from them (paper, Sec. 4).

    Args:
        dag: It has the annotation and the plan of the drawn crops.
        last: The node with the annotation's joints.
        is_trained: Whether hands are found by the network that the run itself trains, instead of the shipped one.

    Returns:
        The node that judges the network in use.
    """
    _add_labelled_crops(dag, last)
    _add_drawn_network(dag)
    dag.add("svegonet", use_svegonet.STAGE)
    _add_trained_networks(dag)
    if is_trained:
        _add_prediction(dag, "", "svegonet_both.weights")
    else:
        _add_prediction(dag, "", "svegonet.weights", evaluate_ego.STAGE)
    seen = {"views": "ingest.views", "crops": "project_ego.crops", "hands": "predict_ego.hands"}
    dag.add("ego_sheet", draw_ego_sheet.STAGE, **seen)
    return "ego_evaluation_both" if is_trained else "ego_evaluation"


def _add_labelled_crops(dag: Dag, last: str) -> None:
    """Add crops with labels: of the annotation, of people, and of what the headset's cameras see by themselves."""
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
        add_evaluation(dag, f"evaluation_ego_only{suffix}", f"ego_only{suffix}", cut_by)
    dag.add("project_tracked", project_ego.STAGE, **{**automatic, "joints": "ego_only.joints"})


def _add_drawn_network(dag: Dag) -> None:
    """Add how the shipped network was trained, on crops that the studio draws."""
    dag.add("drawn_ego_crops", draw_ego_crops.STAGE, orders=CROP_EDGE, chunks="crop_plan.chunks")
    on_drawn = {"members": MEMBER_EDGE, "automatic": "drawn_ego_crops.crops"}
    dag.add("drawn_svegonet", train_svegonet.ON_AUTOMATIC, **on_drawn)


def _add_trained_networks(dag: Dag) -> None:
    """Add the networks that a run trains itself, one for each kind of labels, and how good they are."""
    crops = {"members": MEMBER_EDGE, "manual": "project_manual.crops", "automatic": "project_ego.crops"}
    tracked = {**crops, "automatic": "project_tracked.crops"}
    for name, stage, labelled in (
        ("manual", train_svegonet.ON_MANUAL, crops),
        ("automatic", train_svegonet.ON_AUTOMATIC, crops),
        (ALL_LABELS, train_svegonet.STAGE, crops),
        ("tracked", train_svegonet.ON_AUTOMATIC, tracked),
    ):
        dag.add(f"svegonet_{name}", stage, **{role: labelled[role] for role in stage.inputs})
        _add_prediction(dag, f"_{name}", f"svegonet_{name}.weights", evaluate_ego.OF_JUDGED)


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
