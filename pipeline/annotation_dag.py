"""How videos become 3D joints, round by round."""

from pipeline.graph import CORRECTION_EDGE, SOURCE_EDGE, Dag
from stages import (
    annotate_round,
    audit_recording,
    crop_hands,
    detect_hands,
    detect_keypoints,
    draw_overlays,
    ingest,
    measure_quality,
    read_corrections,
    smooth_joints,
    triangulate,
    undistort,
)


def add_annotation(dag: Dag) -> None:
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


def add_rounds(dag: Dag, num_rounds: int) -> None:
    """Add how the joints of a round are the boxes and the root of the next one; the network stays the same.

    With the round before that a hand that stands still can be told; round 1 knows of none and takes the same one twice.
    Round 1 is there even where none is wanted, so that the parameters of its stage are known.
    """
    for number in range(1, max(num_rounds, 1) + 1):
        joints = "round_0", f"round_{number - 1}", f"round_{max(number - 2, 0)}"
        add_round(dag, f"round_{number}", *joints, corrections="corrections.corrections")


def add_round(dag: Dag, name: str, first: str, before: str, earlier: str, **more: str) -> None:
    """Add a round that starts from the joints of the node ``before``; ``first`` made those of round 0."""
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


def add_results(dag: Dag, last: str) -> None:
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
