"""How the networks of the annotation are trained."""

from pipeline.graph import CROP_EDGE, LABEL_EDGE, Dag
from stages import (
    draw_body_views,
    draw_crops,
    plan_crops,
    read_labels,
    train_body_keypoints,
    train_keypoints,
    train_mvexonet,
)


def add_training(dag: Dag) -> None:
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


def add_own_training(dag: Dag) -> None:
    """Add how networks are trained on recordings that people annotated, all of a run together."""
    dag.add("labels", read_labels.STAGE, sources=LABEL_EDGE, views="ingest.views")
    for name, stage, start in (
        ("own_keypoint_weights", train_keypoints.STAGE, {}),
        ("own_mvexonet_weights", train_mvexonet.STAGE, {"start": "own_keypoint_weights.weights"}),
    ):
        data = {"chunks": "ingest.chunks", "crops": "crop_hands.crops", "labels": "labels.labels", **start}
        dag.add_for_set(name, stage, data)
