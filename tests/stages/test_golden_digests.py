"""Results that moved while the stage's version did not: the store would go on giving out the old ones.

Each pure-number stage runs on a tiny input; the digest of its rounded output stands here beside the version that made
it. Rounding to a thousandth (mm, px, mostly) keeps the last bits, in which processors differ, out of it.
"""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
import torch

from assemblyhands_core.data.arrays import to_arrow, to_numpy
from assemblyhands_core.data.camera_rows import camera_to_row, missing_camera_row, valid_cameras
from assemblyhands_core.data.catalog import CROPS, JOINTS, KEYPOINTS
from assemblyhands_core.data.crop_images import encode_jpeg
from assemblyhands_core.data.digests import digest_json, digest_table
from assemblyhands_core.geometry.crops import crop_camera
from assemblyhands_core.geometry.regions import RemapGrid
from assemblyhands_core.hands.joints import ROOT
from assemblyhands_core.hands.kinematics import HandPose, HandSkeleton, forward_kinematics
from assemblyhands_core.models.mvexonet import SMALL, HandEstimate, MVExoNet
from stages import annotate_round, detect_hands, measure_quality, smooth_joints, triangulate, undistort
from stages._contract import Context, Stage, Tables

_CONTEXT = Context(Path(), "s")
# stage → (version, digest of its outputs)
GOLDEN = {
    "undistort": (1, "8d20006ee7754658c663f02ecc039066e7ba023eb14905a56ba883de6db186c0"),
    "detect_hands": (1, "75c258a77896518217cdafbaf7966808b4a5d22ef1a75191be32bc583ac0f29f"),
    "triangulate": (1, "e6052b3b9cddc606731b798454631f69cd25f1f6fef2808f7c3620d633b37082"),
    "annotate_round": (5, "dad139496d0c214b3aae140e480c8ccc706c024d330708b8ce2c4b6f6d6d8bc1"),
    "measure_quality": (3, "770b7758ac48f1abe8e7f1009768d04b358f37b80acdf49c70aa95b225799b5f"),
    "smooth_joints": (1, "8a2a307361fd93919bf04c3d114dce64faf8147546ae1e20a875ea85a4bb3340"),
}


def test_results_move_only_with_the_version(world: Any, exact_bodies: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("stages.detect_hands.create_body_detector", lambda name, **options: _noisy(exact_bodies()))
    monkeypatch.setattr("assemblyhands_core.models.pretrained.load_mvexonet", lambda path: _Windows())
    made = _run_all(world)
    moved = {name: (stage.version, digest) for name, (stage, digest) in made.items() if _is_stale(stage, digest)}
    assert not moved, f"results moved: bump the version of the stages and write here what they give now: {moved}"
    aged = {name: (stage.version, digest) for name, (stage, digest) in made.items() if GOLDEN[name][0] != stage.version}
    assert not aged, f"versions moved: write here what the stages give now: {aged}"


def test_rounding_hides_the_last_bits_and_nothing_else() -> None:
    def digest(value: float, reason: str = "") -> str:
        columns = {"value_mm": pa.array([value], pa.float64()), "reason": pa.array([reason])}
        return _digest({"out": pa.table(columns)})

    assert digest(2.5) == digest(2.5 + 1e-9) == digest(2.5 - 1e-9)
    assert digest(-1e-9) == digest(1e-9) and digest(float("nan")) == digest(-float("nan"))
    assert len({digest(2.5), digest(2.502), digest(float("nan")), digest(2.5, "too_few_views")}) == 4


def _is_stale(stage: Stage[Any], digest: str) -> bool:
    return GOLDEN[stage.name][0] == stage.version and GOLDEN[stage.name][1] != digest


def _run_all(world: Any) -> dict[str, tuple[Stage[Any], str]]:
    """Run the stages one after the other; return each with the digest of what it made."""
    views = world.views({"c": "missing_video"})
    made: dict[str, tuple[Stage[Any], str]] = {}

    def run(stage: Stage[Any], config: Mapping[str, Any], inputs: Tables) -> Tables:
        outputs = stage.run(stage.config(**config), inputs, _CONTEXT)
        made[stage.name] = stage, _digest(outputs)
        return outputs

    rectified = run(undistort.STAGE, _UNDISTORT, {"views": views})
    inputs = {"chunks": world.chunk(), "views": views, **rectified}
    hands = run(detect_hands.STAGE, _DETECT_HANDS, inputs)
    keypoints = _keypoints(world)
    joints = run(triangulate.STAGE, _TRIANGULATE, {"views": views, "keypoints": keypoints})
    inputs = {"views": views, **rectified, "hand_boxes": hands["hand_boxes"], "crops": _crops(rectified, hands)}
    inputs |= {
        "keypoints": keypoints,
        "triangulated": joints["joints"],
        "joints": joints["joints"],
        "earlier_joints": joints["joints"],
    }
    annotated = run(annotate_round.STAGE, _ANNOTATE_ROUND, inputs)
    inputs = {"views": views, "bodies": hands["bodies"], "body_keypoints": hands["body_keypoints"]}
    inputs |= {"joints": annotated["joints"], "triangulated": joints["joints"], "residuals": joints["residuals"]}
    run(measure_quality.STAGE, _MEASURE_QUALITY, inputs)
    run(smooth_joints.STAGE, _SMOOTH_JOINTS, {"joints": _swinging_hand()})
    return made


_UNDISTORT = {
    "focal_scale_perspective": 0.9,
    "focal_scale_fisheye": 0.7,
    "grid_step_px": 16,
    "lattice_step_px": 32,
    "max_residual_px": 0.05,
    "materialize": False,
    "video_crf": 18,
}
_DETECT_HANDS = {
    "detector": "exact",
    "options": {"exact": {}},
    "every_nth_frame": 2,
    "max_image_side_px": 1280,
    "max_persons": 2,
    "association_px": 40.0,
    "max_reprojection_px": 25.0,
    "max_gap_frames": 3,
    "hand_radius_mm": 130.0,
}
_TRIANGULATE = {
    "max_reprojection_px": 8.0,
    "min_confidence": 0.2,
    "min_views": 2,
    "min_parallax_rad": 0.1,
    "max_span_mm": 250.0,
}
_MEASURE_QUALITY = {"num_sync_frames": 10, "max_shift_frames": 2, "max_reprojection_px": 40.0}

_SMOOTH_JOINTS = {"max_gap_frames": 2, "cutoff_period_frames": 7.0, "max_deviation_sd": 8.0}

_ANNOTATE_ROUND = {
    "weights": __file__,  # any file: the network is made up
    "gamma": 1.5,
    "min_box_joints": 11,
    "min_inside": 0.5,
    "min_views": 2,
    "min_confidence": 0.1,
    "min_keypoint_confidence": 0.1,
    "batch_size": 3,
    "stop_below_mm": 0.0,
    "blend": {"share": 0.3, "within_mm": 25.0},
    "guard": {
        "max_displacement_mm": 180.0,
        "max_body_distance_mm": 400.0,
        "min_size": 0.6,
        "max_size": 1.5,
        "max_bone_mm": 150.0,
        "max_reprojection_ratio": 1.2,
        "min_reprojection_px": 20.0,
        "min_view_share": 0.5,
        "max_spread_ratio": 1.25,
        "max_course_px_ratio": 1.5,
        "min_instants": 8,
    },
}


class _Windows(MVExoNet):
    """A network that answers with a mean hand, moved by where its windows show the world's origin."""

    def __init__(self) -> None:
        torch.nn.Module.__init__(self)
        self.config = SMALL

    def forward(self, images: Any, P_pixel_from_world: Any, is_view_used: Any, root_world_mm: Any, is_left: Any) -> Any:
        origin_px = P_pixel_from_world[..., :2, 3] / P_pixel_from_world[..., 2:, 3].clamp(min=1.0)
        shift_mm = 0.1 * (origin_px * is_view_used[..., None]).sum(dim=1)
        hand = forward_kinematics(HandSkeleton.average(), HandPose("right", np.eye(4), np.zeros(20)))
        joints = root_world_mm[:, None] + torch.from_numpy(hand - hand[ROOT]).float()
        joints[..., :2] += shift_mm[:, None]
        confidence = torch.linspace(0.05, 1.0, 21).expand(len(joints), -1)
        return HandEstimate(joints, confidence, joints, torch.zeros(len(joints), 21, 2, 2, 2))


def _crops(rectified: Tables, hands: Tables) -> pa.Table:
    """Grey crops of the hands that were found."""
    cameras = valid_cameras(rectified["rectified_views"])
    image, rows = encode_jpeg(np.full((32, 32, 3), 99, np.uint8), 90), []
    for box in hands["hand_boxes"].to_pylist():
        row = {name: box[name] for name in (*CROPS.key, "valid", "reason")} | {"image": image}
        if box["valid"]:
            own = crop_camera(cameras[box["camera_id"]], box["center_rectified_px"], 1.5 * box["side_px"], 32)
        rows.append(row | (camera_to_row(own) if box["valid"] else missing_camera_row()))
    return CROPS.from_rows(rows)


def _noisy(detector: Any) -> Any:
    """Return a detector that errs by some pixels, the same ones for the same camera and frame."""
    exact: Callable[..., Any] = detector.detect

    def detect(image: Any, camera_id: str, frame: int) -> Any:
        found = exact(image, camera_id, frame)
        found.keypoints_px[:] += np.random.default_rng([ord(camera_id), frame]).normal(0, 2, found.keypoints_px.shape)
        return found

    detector.detect = detect
    return detector


def _keypoints(world: Any) -> pa.Table:
    """Both hands over four frames: noise, outliers and holes."""
    generator = np.random.default_rng(5)
    points_mm = generator.uniform(-80, 80, (4, 2, 21, 3)) + np.array([[-200.0, 0, -250], [200.0, 0, -250]])[:, None]
    rows = []
    for camera in world.cameras:
        pixels = camera.project(points_mm) + generator.normal(0, 1.5, (4, 2, 21, 2))
        pixels[generator.random((4, 2, 21)) < 0.1] += 60.0
        confidence = np.where(generator.random((4, 2, 21)) < 0.2, 0.0, generator.uniform(0.1, 1, (4, 2, 21)))
        for frame in range(4):
            for h, hand in enumerate(("right", "left")):
                row = {"sequence_id": "s", "frame": frame, "hand": hand, "camera_id": camera.camera_id}
                row |= {"keypoints_px": pixels[frame, h].ravel(), "confidence": confidence[frame, h]}
                rows.append(row | {"source": "test", "valid": True, "reason": ""})
    return KEYPOINTS.from_rows(rows)


def _swinging_hand() -> pa.Table:
    """A hand that moves for forty frames: noise, strays and holes."""
    generator = np.random.default_rng(6)
    hand = forward_kinematics(HandSkeleton.average(), HandPose("left", np.eye(4), np.zeros(20)))
    points_mm = hand + 150 * np.sin(np.arange(40) / 8)[:, None, None] + generator.normal(0, 2, (40, 21, 3))
    points_mm[generator.random((40, 21)) < 0.03] += 80.0
    points_mm[generator.random((40, 21)) < 0.3] = np.nan
    is_valid = np.isfinite(points_mm).all(axis=-1)
    columns = {"valid": is_valid, "reason": np.where(is_valid, "", "too_few_views"), "num_views": 3 * is_valid}
    columns |= {"reprojection_px": np.where(is_valid, 2.0, np.nan), "joints_world_mm": points_mm}
    names = {"sequence_id": ["s"] * 40, "frame": np.arange(40), "hand": ["left"] * 40}
    return JOINTS.build({**names, **columns, "source": ["test"] * 40, "round": [0] * 40})


def _digest(tables: Tables) -> str:
    return digest_json({name: digest_table(_rounded(table)) for name, table in tables.items()})


def _rounded(table: pa.Table) -> pa.Table:
    """Return a table with every floating-point column rounded to 0.001, and remap grids to 0.01 px."""
    for index, field in enumerate(table.schema):
        column = table.column(field.name)
        is_list = pa.types.is_fixed_size_list(field.type)
        if field.name == "grid":
            table = table.set_column(index, field.name, pa.array([_rounded_grid(data) for data in column.to_pylist()]))
        elif pa.types.is_floating(field.type.value_type if is_list else field.type):
            values = np.round(to_numpy(column).astype(np.float64), 3) + 0.0  # -0 is 0
            kind = pa.list_(pa.float64(), field.type.list_size) if is_list else pa.float64()
            table = table.set_column(index, field.name, to_arrow(values, kind))
    return table.replace_schema_metadata(None)


def _rounded_grid(data: bytes) -> bytes:
    return (np.round(RemapGrid.from_bytes(data).source_px.astype("<f8"), 2) + 0.0).tobytes() if data else b""


def test_the_input_is_worth_it(world: Any) -> None:
    """A digest of empty tables would never move."""
    tables = triangulate.STAGE.run(
        triangulate.TriangulateConfig(**_TRIANGULATE),
        {"views": world.views(), "keypoints": _keypoints(world)},
        _CONTEXT,
    )
    reasons = to_numpy(tables["joints"].column("reason"))
    assert set(reasons.ravel()) >= {"", "too_few_views", "high_reprojection"} and (reasons == "").mean() > 0.5
