"""The whole way of the data."""

from collections.abc import Sequence
from typing import Final

from pipeline.annotation_dag import add_annotation, add_results, add_rounds
from pipeline.egocentric_dag import ALL_LABELS, EGO_NETWORKS, add_egocentric
from pipeline.evaluation_dag import add_evaluations
from pipeline.graph import Dag
from pipeline.studio_dag import add_studio
from pipeline.training_dag import add_own_training, add_training
from pipeline.verb_dag import add_verbs

LOOKING_TARGETS: Final = frozenset({"doctor"})
"""They make nothing that anyone would go on with."""


def build_dag(num_rounds: int = 3, is_ego_trained: bool = False, ego_labels: Sequence[str] = (ALL_LABELS,)) -> Dag:
    """Return the whole pipeline; its annotation is that of the last round, 2D + triangulation without any.

    Args:
        num_rounds: How often the annotation is refined.
        is_ego_trained: Whether hands in the headset's pictures are found by the SVEgoNet that the run itself trains on
            all its labels, instead of the shipped one.
        ego_labels: For which of `EGO_NETWORKS` the target ``all`` has a network of its own.
    """
    dag = Dag()
    add_studio(dag)
    add_training(dag)
    add_annotation(dag)
    add_rounds(dag, num_rounds)
    add_results(dag, f"round_{num_rounds}")
    add_own_training(dag)
    judged_ego = add_egocentric(dag, f"round_{num_rounds}", is_ego_trained)
    evaluations = add_evaluations(dag, num_rounds)
    add_verbs(dag, f"round_{num_rounds}")
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
        "cross": tuple(f"{node}_{labels}" for labels in EGO_NETWORKS for node in ("svegonet", "ego_evaluation")),
        "predict": ("predict_ego", "predict_manual", judged_ego, "ego_sheet"),
        "label_quality": tuple(
            f"{node}_{labels}" for labels in ("automatic", "tracked") for node in ("svegonet", "ego_evaluation")
        ),
        "ego_only": ("evaluation_ego_only", "evaluation_ego_only_manual"),
        "verbs": ("verb_table", "verb_table_manual"),
        "train_verbs": ("own_verb_table", "own_verb_table_manual"),
        "all": (
            *("quality", "overlay", *evaluations, "evaluation_bound"),
            *(f"{node}_{labels}" for labels in ego_labels for node in ("svegonet", "ego_evaluation")),
            *(judged_ego, "ego_sheet"),
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
