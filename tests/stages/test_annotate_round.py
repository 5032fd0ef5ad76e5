"""Rounds of annotation with a network whose answer is known, and with a tiny one that knows nothing."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
import torch

from assemblyhands_core.data.arrays import to_numpy
from assemblyhands_core.data.camera_rows import camera_to_row, missing_camera_row, valid_cameras
from assemblyhands_core.data.catalog import CORRECTIONS, CROPS, HAND_BOXES, JOINTS, KEYPOINTS
from assemblyhands_core.data.crop_images import encode_jpeg
from assemblyhands_core.data.digests import digest_file
from assemblyhands_core.geometry.crops import crop_camera
from assemblyhands_core.hands.joints import HANDS, JOINT_NAMES, ROOT
from assemblyhands_core.hands.kinematics import HandPose, HandSkeleton, forward_kinematics
from assemblyhands_core.models.mvexonet import HandEstimate, MVExoNet, MVExoNetConfig
from assemblyhands_core.models.pretrained import save_weights
from stages._contract import Context
from stages.annotate_round import STAGE, AnnotateRoundConfig, BlendConfig, GuardConfig

SIZE_PX, CROP_PX, MARGIN, RADIUS_MM = 64, 96, 1.5, 130.0
FRAMES = (4, 5)
TINY = MVExoNetConfig("mobilenetv3_small_050", 3, 8, image_size_px=SIZE_PX, num_voxels=8, v2v="slim")
GUARD = GuardConfig(
    max_displacement_mm=100.0,
    max_body_distance_mm=250.0,
    min_size=0.6,
    max_size=1.5,
    max_bone_mm=150.0,
    max_reprojection_ratio=3.0,
    max_spread_ratio=1.25,
    max_course_px_ratio=1.5,
    min_instants=8,
    min_reprojection_px=12.0,
    min_view_share=0.5,
)
CONFIG = AnnotateRoundConfig(
    weights="weights.safetensors",
    gamma=1.5,
    min_box_joints=11,
    min_inside=0.5,
    min_views=2,
    min_confidence=0.1,
    min_keypoint_confidence=0.1,
    batch_size=8,
    stop_below_mm=0.0,
    blend=BlendConfig(share=0.0, within_mm=10.0),
    guard=GUARD,
)
Answer = Callable[[int, np.ndarray, bool], np.ndarray]  # (call's row, root, is left) → joints


def _hand(hand: str, wrist_mm: tuple[float, float, float]) -> np.ndarray:
    """A slightly bent mean hand, fingers towards -y."""
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[:3, 3] = wrist_mm
    return forward_kinematics(HandSkeleton.average(), HandPose(hand, pose, np.full(20, 0.2)))  # type: ignore[arg-type]


TRUE_MM = {
    (frame, hand): _hand(hand, ((-200.0 if hand == "right" else 200.0) + 5 * frame, 60.0, -100.0))
    for frame in FRAMES
    for hand in HANDS
}
KEYS = list(TRUE_MM)


class KnownAnswer(MVExoNet):
    """A network that was told what to say, and remembers what it was shown."""

    def __init__(self, answer: Answer, confidence: float = 0.9) -> None:
        torch.nn.Module.__init__(self)
        self.config, self.answer, self.confidence = TINY, answer, confidence
        self.seen: list[Any] = []

    def forward(self, images: Any, P_pixel_from_world: Any, is_view_used: Any, root_world_mm: Any, is_left: Any) -> Any:
        first = len(self.seen)
        self.seen += zip(images, P_pixel_from_world.double(), is_view_used, root_world_mm, is_left, strict=True)
        roots = zip(root_world_mm.double().numpy(), is_left.tolist(), strict=True)
        joints = torch.from_numpy(np.stack([self.answer(first + i, *pair) for i, pair in enumerate(roots)])).float()
        confidence = torch.full(joints.shape[:2], self.confidence)
        return HandEstimate(joints, confidence, joints, torch.zeros(len(joints), 21, 2, 2, 2))


@dataclass
class Scene:
    """Two hands over two frames, as the stages before would tell of them."""

    world: Any
    inputs: dict[str, pa.Table]

    @property
    def cameras(self) -> list[Any]:
        return list(self.world.cameras)

    @property
    def rectified(self) -> Mapping[str, Any]:
        return valid_cameras(self.inputs["rectified_views"])


def _center(key: tuple[int, str]) -> np.ndarray:
    return np.asarray(TRUE_MM[key].mean(axis=0) + np.array([10.0, 0.0, 0.0]))


def _side(camera: Any, key: tuple[int, str]) -> float:
    return float(2 * RADIUS_MM * camera.fx_px / camera.depth_mm(_center(key)))


def _names(key: tuple[int, str], **more: Any) -> dict[str, Any]:
    return {"sequence_id": "s", "frame": key[0], "hand": key[1], **more}


def _boxes(rectified: Mapping[str, Any]) -> pa.Table:
    rows = []
    for key in KEYS:
        for name, camera in rectified.items():
            box = {"center_rectified_px": camera.project(_center(key)), "side_px": _side(camera, key)}
            row = _names(key, camera_id=name) | {"hand_center_world_mm": _center(key), "source": "detected"}
            rows.append(row | box | {"valid": True, "reason": ""})
    return HAND_BOXES.from_rows(rows)


def _crops(rectified: Mapping[str, Any], holes: tuple[str, ...] = ()) -> pa.Table:
    """Black crops with a blob where the root is."""
    rows = []
    for key in KEYS:
        for name, camera in rectified.items():
            is_valid = name not in holes
            place = camera.project(_center(key)), MARGIN * _side(camera, key)
            own = crop_camera(camera, *place, CROP_PX)
            y, x = np.mgrid[:CROP_PX, :CROP_PX]
            u, v = own.project(TRUE_MM[key][ROOT])
            blob = 250 * np.exp(-((x - u) ** 2 + (y - v) ** 2) / (2 * 2.5**2))
            image = encode_jpeg(np.repeat(blob[..., None], 3, axis=2).astype(np.uint8), 100)
            columns = camera_to_row(own) | {"image": image} if is_valid else missing_camera_row() | {"image": b""}
            reason = "" if is_valid else "outside_view"
            rows.append(_names(key, camera_id=name) | columns | {"valid": is_valid, "reason": reason})
    return CROPS.from_rows(rows)


def _keypoints(cameras: list[Any], offset_px: tuple[float, float] = (0.0, 0.0)) -> pa.Table:
    rows = []
    for key in KEYS:
        for camera in cameras:
            pixels = camera.project(TRUE_MM[key]) + offset_px
            row = _names(key, camera_id=camera.camera_id) | {"keypoints_px": pixels, "confidence": np.ones(21)}
            rows.append(row | {"source": "test", "valid": True, "reason": ""})
    return KEYPOINTS.from_rows(rows)


def _joints(
    number: int = 0,
    shift_mm: Any = 0.0,
    missing: tuple[int, ...] = (),
    source: str = "2d_triangulation",
    points: Mapping[tuple[int, str], np.ndarray] = TRUE_MM,
) -> pa.Table:
    rows = []
    for key in KEYS:
        valid = ~np.isin(np.arange(21), missing)
        found = np.where(valid[:, None], points[key] + shift_mm, np.nan)
        outcome = {"valid": valid, "reason": np.where(valid, "", "no_detection").tolist()}
        outcome |= {"num_views": np.full(21, 4), "reprojection_px": np.where(valid, 1.0, np.nan)}
        rows.append(_names(key, joints_world_mm=found, source=source, round=number) | outcome)
    return JOINTS.from_rows(rows)


@pytest.fixture
def scene(world: Any) -> Scene:
    torch.set_num_threads(1)
    views = world.views()
    rectified_views = world.rectified(views)
    rectified = valid_cameras(rectified_views)
    inputs = {
        "views": views,
        "rectified_views": rectified_views,
        "hand_boxes": _boxes(rectified),
        "crops": _crops(rectified),
        "keypoints": _keypoints(world.cameras),
        "joints": _joints(),
        "triangulated": _joints(),
        "earlier_joints": _joints(),
    }
    return Scene(world, inputs)


@pytest.fixture
def run(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> Callable[..., dict[str, list[dict[str, Any]]]]:
    """Return the stage, run with a network and some of its inputs and parameters replaced."""

    def run_stage(network: MVExoNet, inputs: Any = None, **how: Any) -> dict[str, list[dict[str, Any]]]:
        monkeypatch.setattr("assemblyhands_core.models.pretrained.load_mvexonet", lambda path: network)
        tables = STAGE.run(CONFIG.model_copy(update=how), scene.inputs | (inputs or {}), Context(Path(), "s"))
        return {name: table.to_pylist() for name, table in tables.items()}

    return run_stage


def _moved(*shift_mm: float) -> Answer:
    """The truth, in the order of the rows, moved."""
    return lambda row, root, is_left: TRUE_MM[KEYS[row]] + np.array(shift_mm or (0.0, 0.0, 0.0))


def _points(row: dict[str, Any]) -> np.ndarray:
    return np.array(row["joints_world_mm"]).reshape(21, 3)


def _project(P: Any, point: np.ndarray) -> np.ndarray:
    x, y, depth = np.asarray(P) @ np.append(point, 1.0)
    return np.array([x, y]) / depth


def _focal(P: Any) -> float:
    x, _, z = np.asarray(P)[:, :3]
    return float(np.linalg.norm(x - (x @ z) * z))


def test_a_round_gives_what_the_network_says(run: Any) -> None:
    network = KnownAnswer(_moved(1.0, 2.0, 2.0))
    tables = run(network)
    assert [(row["frame"], row["hand"]) for row in tables["joints"]] == KEYS
    assert [bool(seen[4]) for seen in network.seen] == [hand == "left" for _, hand in KEYS]
    for key, row, detail in zip(KEYS, tables["joints"], tables["rounds"], strict=True):
        np.testing.assert_allclose(_points(row), TRUE_MM[key] + (1.0, 2.0, 2.0), atol=1e-3)
        assert all(row["valid"]) and set(row["reason"]) == {""} and set(row["num_views"]) == {4}
        assert (row["round"], row["source"]) == (1, "mvexonet")
        assert (detail["round"], detail["kept_round"], detail["num_views"], detail["reason"]) == (1, 1, 4, "")
        assert detail["displacement_mm"] == pytest.approx(3.0, abs=1e-3) and not detail["is_crop_outside"]
        assert detail["confidence"] == pytest.approx(0.9) and detail["note"] == ""


def test_what_is_believed_is_mixed_with_triangulated_joints_near_by(run: Any) -> None:
    """10 mm off, and triangulated joints on the truth: a share of 0.4 leaves 6 mm."""
    answer, mix = _moved(0.0, 6.0, 8.0), BlendConfig(share=0.4, within_mm=10.5)
    for row, key in zip(run(KnownAnswer(answer), blend=mix)["joints"], KEYS, strict=True):
        np.testing.assert_allclose(_points(row), TRUE_MM[key] + (0.0, 3.6, 4.8), atol=1e-3)
        assert row["source"] == "mvexonet" and np.mean(row["reprojection_px"]) > 0.1
    for changed, inputs in (
        ({"blend": BlendConfig(share=0.4, within_mm=9.5)}, {}),
        ({"blend": mix}, {"triangulated": _joints(missing=tuple(range(21)))}),
    ):
        for row, key in zip(run(KnownAnswer(answer), inputs, **changed)["joints"], KEYS, strict=True):
            np.testing.assert_allclose(_points(row), TRUE_MM[key] + (0.0, 6.0, 8.0), atol=1e-3)


def test_the_reprojection_of_a_mixed_joint_is_its_own(run: Any) -> None:
    alone, mixed = (
        run(KnownAnswer(_moved(0.0, 6.0, 8.0)), blend=BlendConfig(share=share, within_mm=20.0))["joints"]
        for share in (0.0, 0.5)
    )
    ratios = [np.divide(b["reprojection_px"], a["reprojection_px"]) for a, b in zip(alone, mixed, strict=True)]
    np.testing.assert_allclose(ratios, 0.5, atol=0.02)


def test_round_1_looks_at_the_detected_boxes_around_the_triangulated_root(run: Any, scene: Scene) -> None:
    network = KnownAnswer(_moved())
    assert {row["box_source"] for row in run(network)["rounds"]} == {"detected"}
    for key, (_, matrices, is_used, root, _) in zip(KEYS, network.seen, strict=True):
        np.testing.assert_allclose(root, TRUE_MM[key][ROOT], atol=1e-4)
        assert is_used.all()
        for P, camera in zip(matrices, scene.rectified.values(), strict=True):
            np.testing.assert_allclose(_project(P, _center(key)), (SIZE_PX - 1) / 2, atol=2e-3)
            assert _focal(P) == pytest.approx(camera.fx_px * SIZE_PX / _side(camera, key), rel=1e-5)


def test_later_rounds_look_at_the_joints_of_the_round_before(run: Any) -> None:
    shift_mm = np.array([6.0, -8.0, 4.0])
    network = KnownAnswer(_moved())
    rounds = run(network, {"joints": _joints(1, shift_mm, source="mvexonet")})["rounds"]
    assert {row["box_source"] for row in rounds} == {"joints"} and {row["round"] for row in rounds} == {2}
    for key, (_, matrices, _, root, _) in zip(KEYS, network.seen, strict=True):
        np.testing.assert_allclose(root, TRUE_MM[key][ROOT] + shift_mm, atol=1e-4)
        for P in matrices:
            pixels = np.stack([_project(P, point) for point in TRUE_MM[key] + shift_mm])
            lower, upper = pixels.min(axis=0), pixels.max(axis=0)
            np.testing.assert_allclose((lower + upper) / 2, (SIZE_PX - 1) / 2, atol=1e-2)
            assert (upper - lower).max() == pytest.approx(SIZE_PX / 1.5, abs=1e-2)


@pytest.mark.parametrize("number", [0, 1])
def test_matrices_say_where_things_are_in_the_pictures(run: Any, number: int) -> None:
    """A blob drawn at the root is where the window's matrix projects the root."""
    network = KnownAnswer(_moved())
    run(network, {"joints": _joints(number)})
    for key, (images, matrices, _, _, _) in zip(KEYS, network.seen, strict=True):
        for image, P in zip(images.numpy(), matrices, strict=True):
            weight = np.where(image[0] > 0.1, image[0], 0.0)
            y, x = np.mgrid[:SIZE_PX, :SIZE_PX]
            found = np.array([(x * weight).sum(), (y * weight).sum()]) / weight.sum()
            np.testing.assert_allclose(found, _project(P, TRUE_MM[key][ROOT]), atol=0.1)


def test_with_few_joints_the_detected_box_and_without_root_the_bodys_centre_is_taken(run: Any) -> None:
    network = KnownAnswer(_moved())
    few = _joints(1, missing=tuple(range(11)))
    assert {row["box_source"] for row in run(network, {"joints": few})["rounds"]} == {"detected"}
    network = KnownAnswer(_moved())
    no_root = _joints(1, missing=(ROOT,))
    assert {row["box_source"] for row in run(network, {"joints": no_root})["rounds"]} == {"joints"}
    for key, seen in zip(KEYS, network.seen, strict=True):
        np.testing.assert_allclose(seen[3], _center(key), atol=1e-4)


def test_views_without_a_crop_are_not_used_and_with_too_few_a_hand_keeps_its_joints(run: Any, scene: Scene) -> None:
    network = KnownAnswer(_moved())
    tables = run(network, {"crops": _crops(scene.rectified, ("b",))})
    assert all(seen[2].sum() == 3 for seen in network.seen)
    assert all(set(row["num_views"]) == {3} and all(row["valid"]) for row in tables["joints"])
    network = KnownAnswer(_moved())
    tables = run(network, {"crops": _crops(scene.rectified, ("a", "b", "c"))})
    assert not network.seen
    for row, detail in zip(tables["joints"], tables["rounds"], strict=True):
        assert row["source"] == "kept_round_0" and all(row["valid"])
        assert (detail["reason"], detail["note"]) == ("too_few_views", "1 views, 2 are needed")
        assert detail["num_views"] == 1 and np.isnan(detail["confidence"])
    tables = run(network, {"crops": _crops(scene.rectified, ("a", "b", "c"))}, min_views=1)
    assert all(all(row["valid"]) for row in tables["joints"])


def test_a_hand_that_nobody_can_place_has_its_reason(run: Any, scene: Scene) -> None:
    boxes = scene.inputs["hand_boxes"]
    place = boxes.schema.get_field_index("hand_center_world_mm")
    nowhere = pa.array([[np.nan] * 3] * boxes.num_rows, boxes.schema.field(place).type)
    unknown = {"hand_boxes": boxes.set_column(place, boxes.schema.field(place), nowhere)}
    rows = run(KnownAnswer(_moved()), unknown | {"joints": _joints(missing=(ROOT,))})
    assert {row["reason"] for row in rows["rounds"]} == {"no_root"}
    assert all(row["reason"][ROOT] != "" and row["source"] == "kept_round_0" for row in rows["joints"])
    assert {row["reason"] for row in run(KnownAnswer(_moved()), unknown)["rounds"]} == {""}


def test_windows_that_leave_the_stored_crop_say_so(run: Any) -> None:
    """The stored crop is 390 mm wide around the hand."""
    rounds = run(KnownAnswer(_moved(0.0, 90.0, 0.0)), {"joints": _joints(1, (0.0, 90.0, 0.0))})["rounds"]
    assert all(row["is_crop_outside"] and row["num_views"] == 4 for row in rounds)
    tables = run(KnownAnswer(_moved()), {"joints": _joints(1, (0.0, 300.0, 0.0))})
    assert {row["reason"] for row in tables["rounds"]} == {"too_few_views"}


def test_joints_that_the_network_is_not_sure_of_are_missing(run: Any) -> None:
    tables = run(KnownAnswer(_moved(), confidence=0.09))
    assert {row["source"] for row in tables["joints"]} == {"kept_round_0"}
    assert {(row["reason"], row["kept_round"]) for row in tables["rounds"]} == {("low_confidence", 0)}
    assert tables["rounds"][0]["confidence"] == pytest.approx(0.09)
    nothing = run(KnownAnswer(_moved(), confidence=0.09), {"joints": _joints(missing=tuple(range(21)))})["joints"]
    assert all(set(row["reason"]) == {"low_confidence"} and np.isnan(_points(row)).all() for row in nothing)


def test_reprojection_is_against_the_keypoints_in_the_videos_own_pixels(run: Any, scene: Scene) -> None:
    tables = run(KnownAnswer(_moved()), {"keypoints": _keypoints(scene.cameras, (3.0, -4.0))})
    assert all(np.allclose(row["reprojection_px"], 5.0, atol=1e-3) for row in tables["joints"])
    none = run(KnownAnswer(_moved()), {"keypoints": KEYPOINTS.empty()})["joints"]
    assert all(np.isnan(row["reprojection_px"]).all() and all(row["valid"]) for row in none)


def _scaled(factor: float) -> Answer:
    return lambda row, root, is_left: root + factor * (TRUE_MM[KEYS[row]] - TRUE_MM[KEYS[row]][ROOT])


@pytest.mark.parametrize(
    ("answer", "believed", "reason", "note"),
    [
        (_moved(0.0, 101.0, 0.0), _moved(0.0, 30.0, 0.0), "jumped", "its root jumped 101 mm"),
        (_scaled(1.6), _scaled(1.4), "implausible_bones", "1.60 of a mean hand's size"),
        (_scaled(0.5), _scaled(0.7), "implausible_bones", "0.50 of a mean hand's size"),
        (_moved(0.0, 90.0, 0.0), _moved(0.0, 60.0, 0.0), "high_reprojection", "px from the 2D keypoints, before 0.0"),
    ],
)
def test_an_estimate_beyond_belief_gives_way_to_the_round_before(
    run: Any, answer: Answer, believed: Answer, reason: str, note: str
) -> None:
    tables = run(KnownAnswer(answer))
    for key, row, detail in zip(KEYS, tables["joints"], tables["rounds"], strict=True):
        np.testing.assert_allclose(_points(row), TRUE_MM[key], atol=1e-3)
        assert (row["round"], row["source"], set(row["reason"])) == (1, "kept_round_0", {""})
        assert (detail["kept_round"], detail["reason"]) == (0, reason) and note in detail["note"]
    tables = run(KnownAnswer(believed))
    assert {row["kept_round"] for row in tables["rounds"]} == {1}
    assert {row["source"] for row in tables["joints"]} == {"mvexonet"}


def test_joints_that_stand_on_a_view_of_four_are_nothing_to_hold_a_new_estimate_against(run: Any) -> None:
    answer, joints = _moved(0.0, 90.0, 0.0), _joints()
    place = joints.schema.get_field_index("num_views")
    for num_views, reason in ((2, "high_reprojection"), (1, "")):
        column = pa.array([[num_views] * 21] * joints.num_rows, joints.schema.field(place).type)
        few = {"joints": joints.set_column(place, joints.schema.field(place), column)}
        assert {row["reason"] for row in run(KnownAnswer(answer), few)["rounds"]} == {reason}


def test_a_hand_whose_bones_vary_and_that_fits_its_keypoints_worse_keeps_the_round_before_all_along(run: Any) -> None:
    def answer(row: int, root: np.ndarray, is_left: bool) -> np.ndarray:
        varies = KEYS[row] == (FRAMES[1], "right")
        return _scaled(1.05 if varies else 1.0)(row, root, is_left) + 0.5

    tables = run(KnownAnswer(answer), guard=GUARD.model_copy(update={"min_instants": 2}))
    reasons = [(row["hand"], row["reason"], row["kept_round"]) for row in tables["rounds"]]
    assert sorted(set(reasons)) == [("left", "", 1), ("right", "unsteady", 0)] and len(reasons) == 4
    assert "0.0 mm in 2D + triangulation" in tables["rounds"][0]["note"]
    assert {row["reason"] for row in run(KnownAnswer(answer))["rounds"]} == {""}, "two instants say nothing by default"


def test_from_the_truth_an_estimate_counts_however_far_off_it_is(run: Any) -> None:
    true = _joints(number=100)
    tables = run(
        KnownAnswer(_moved(0.0, 101.0, 0.0)), {"joints": true}, guard=GUARD.model_copy(update={"min_instants": 2})
    )
    assert {(row["round"], row["source"]) for row in tables["joints"]} == {(101, "mvexonet")}


def test_a_hand_does_not_become_the_other_one(run: Any) -> None:
    """Hands 60 mm apart: a jump by half of it and more ends nearer to the other one."""
    near = {key: TRUE_MM[key] - TRUE_MM[key][ROOT] + (60.0 * (key[1] == "left"), 0.0, -100.0) for key in KEYS}
    inputs = {"joints": _joints(points=near), "keypoints": KEYPOINTS.empty()}
    guard = GUARD.model_copy(update={"max_body_distance_mm": 1e4})

    def answer(shift_mm: float) -> Answer:
        return lambda row, root, is_left: near[KEYS[row]] + ((-shift_mm if is_left else shift_mm), 0.0, 0.0)

    assert {row["reason"] for row in run(KnownAnswer(answer(31.0)), inputs, guard=guard)["rounds"]} == {"other_hand"}
    assert {row["reason"] for row in run(KnownAnswer(answer(29.0)), inputs, guard=guard)["rounds"]} == {""}


def test_a_hand_does_not_leave_its_body(run: Any) -> None:
    guard = GUARD.model_copy(update={"max_body_distance_mm": 60.0})
    tables = run(KnownAnswer(_moved(-29.0, 0.0, 0.0)), guard=guard)
    distances = [np.linalg.norm(TRUE_MM[key][ROOT] - (29.0, 0.0, 0.0) - _center(key)) for key in KEYS]
    assert [row["reason"] for row in tables["rounds"]] == ["left_body" if d > 60 else "" for d in distances]
    assert {row["reason"] for row in run(KnownAnswer(_moved()), guard=guard)["rounds"]} == {""}


def test_without_a_round_before_to_keep_what_is_not_believed_is_missing(run: Any) -> None:
    tables = run(KnownAnswer(_scaled(2.0)), {"joints": _joints(missing=tuple(range(21)))})
    for row, detail in zip(tables["joints"], tables["rounds"], strict=True):
        assert set(row["reason"]) == {"implausible_bones"} and np.isnan(_points(row)).all()
        assert detail["kept_round"] == 1 and np.isnan(detail["displacement_mm"])


def test_a_hand_that_kept_its_joints_has_not_converged(run: Any) -> None:
    network = KnownAnswer(_moved())
    kept = {"joints": _joints(2, source="kept_round_1"), "earlier_joints": _joints(1)}
    assert {row["reason"] for row in run(network, kept, stop_below_mm=2.0)["rounds"]} == {""} and len(network.seen) == 4


def test_joints_that_are_kept_twice_still_tell_their_round(run: Any) -> None:
    kept = run(KnownAnswer(_scaled(2.0)), {"joints": _joints(1, source="kept_round_0")})
    assert {row["source"] for row in kept["joints"]} == {"kept_round_0"}
    assert {(row["round"], row["kept_round"]) for row in kept["rounds"]} == {(2, 0)}


def test_a_hand_that_stands_still_is_not_estimated_anew_on_request(run: Any) -> None:
    shift_mm = np.zeros((21, 3))
    before = {key: TRUE_MM[key] + (shift_mm + (1.0 if key[0] == FRAMES[0] else 3.0, 0.0, 0.0)) for key in KEYS}
    inputs = {"earlier_joints": _joints(1, points=before), "joints": _joints(2, source="mvexonet")}
    network = KnownAnswer(lambda row, root, is_left: TRUE_MM[KEYS[2 + row]] + (0.5, 0.0, 0.0))
    tables = run(network, inputs, stop_below_mm=2.0)
    assert len(network.seen) == 2
    assert [row["reason"] for row in tables["rounds"]] == ["converged", "converged", "", ""]
    assert [row["kept_round"] for row in tables["rounds"]] == [2, 2, 3, 3]
    assert [row["displacement_mm"] for row in tables["rounds"]] == pytest.approx([0.0, 0.0, 0.5, 0.5], abs=1e-3)
    assert [row["source"] for row in tables["joints"]] == ["kept_round_2"] * 2 + ["mvexonet"] * 2
    for stop_below_mm, given in ((0.0, inputs), (2.0, {"joints": inputs["joints"], "earlier_joints": _joints(2)})):
        network = KnownAnswer(_moved())
        run(network, given, stop_below_mm=stop_below_mm)
        assert len(network.seen) == 4


@pytest.fixture(scope="module")
def tiny() -> MVExoNet:
    torch.manual_seed(0)
    return MVExoNet(TINY).eval()


def _with_trust(how: Mapping[str, Any]) -> dict[str, Any]:
    """Believe whatever an untrained network says."""
    wide = dict.fromkeys(("max_displacement_mm", "max_body_distance_mm", "max_size", "max_bone_mm"), 1e4)
    guard = GUARD.model_copy(update={**wide, "min_size": 0.0, "min_reprojection_px": 1e4})
    return {"guard": guard, "min_confidence": 0.0, **how}


def test_batches_do_not_matter_and_equal_runs_are_equal(run: Any, scene: Scene, tiny: MVExoNet) -> None:
    crops = scene.inputs["crops"]
    without = [not (row["frame"] == 4 and row["camera_id"] in "ab") for row in crops.to_pylist()]
    inputs = {"crops": crops.filter(pa.array(without))}
    together, again = (run(tiny, inputs, **_with_trust({})) for _ in range(2))
    assert str(together) == str(again)  # NaN is not itself
    alone = run(tiny, inputs, **_with_trust({"batch_size": 1}))
    for one, other in zip(together["joints"], alone["joints"], strict=True):
        assert all(one["valid"]) and np.ptp(_points(one), axis=0).max() > 1e-2
        np.testing.assert_allclose(_points(one), _points(other), atol=1e-3)
    turned = run(tiny, inputs | {"joints": _joints().take([3, 0, 2])}, **_with_trust({}))["joints"]
    assert [(row["frame"], row["hand"]) for row in turned] == [KEYS[3], KEYS[0], KEYS[2]]
    np.testing.assert_allclose(_points(turned[1]), _points(together["joints"][0]), atol=1e-3)


def test_weights_come_from_the_file_of_the_config(scene: Scene, tiny: MVExoNet, tmp_path: Path) -> None:
    path = tmp_path / "tiny.safetensors"
    save_weights(path, tiny, {})
    config = CONFIG.model_copy(update=_with_trust({"weights": str(path)}))
    tables = STAGE.run(config, scene.inputs, Context(tmp_path, "s"))
    assert to_numpy(tables["joints"]["valid"]).all() and tables["rounds"].num_rows == 4
    assert STAGE.externals(config, "s") == {"weights": digest_file(path)}
    with pytest.raises(ValueError, match=r"no weights at .*/nowhere\.safetensors: run `make train`"):
        STAGE.externals(config.model_copy(update={"weights": "nowhere.safetensors"}), "s")


def test_no_rows_give_empty_tables(run: Any) -> None:
    assert run(KnownAnswer(_moved()), {"joints": JOINTS.empty()}) == {"joints": [], "rounds": []}


def _corrections(scene: Scene, key: tuple[int, str], joints: tuple[int, ...], num_views: int) -> pa.Table:
    """What people would set: the truth, in the first views."""
    rows = [
        _names(key, camera_id=camera.camera_id, joint=JOINT_NAMES[joint], visibility=2, weight=10.0)
        | {"corrected_px": camera.project(TRUE_MM[key][joint])}
        for camera in scene.cameras[:num_views]
        for joint in joints
    ]
    return CORRECTIONS.from_rows(rows)


def test_joints_that_people_hold_stay_where_they_are(run: Any, scene: Scene) -> None:
    """The network is 3 mm off; of one hand, two joints were set in two views, and one in a single view."""
    both = _corrections(scene, KEYS[1], (2, 20), 2)
    given = {"corrections": pa.concat_tables([both, _corrections(scene, KEYS[1], (7,), 1)])}
    tables = run(KnownAnswer(_moved(1.0, 2.0, 2.0)), given)
    for key, row, detail in zip(KEYS, tables["joints"], tables["rounds"], strict=True):
        expected = TRUE_MM[key] + (1.0, 2.0, 2.0)
        if key == KEYS[1]:
            expected[[2, 20]] = TRUE_MM[key][[2, 20]]
        np.testing.assert_allclose(_points(row), expected, atol=1e-3)
        assert row["source"] == ("manual" if key == KEYS[1] else "mvexonet")
        assert (f"corrected in one view, two hold a joint: {JOINT_NAMES[7]}" == detail["note"]) == (key == KEYS[1])
        assert detail["kept_round"] == 1


def test_held_joints_survive_a_network_that_is_not_sure_and_one_that_is_not_believed(run: Any, scene: Scene) -> None:
    corrections = {"corrections": _corrections(scene, KEYS[0], (4,), 2)}
    for network in (KnownAnswer(_moved(), confidence=0.01), KnownAnswer(_moved(500.0, 0.0, 0.0))):
        first = run(network, corrections)["joints"][0]
        np.testing.assert_allclose(_points(first)[4], TRUE_MM[KEYS[0]][4], atol=1e-3)
        assert first["valid"][4] and first["source"] == "manual" and first["num_views"][4] == 4


def test_a_joint_that_could_not_be_triangulated_is_not_held(run: Any, scene: Scene) -> None:
    given = {"corrections": _corrections(scene, KEYS[0], (4,), 2), "triangulated": _joints(missing=(4,))}
    first = run(KnownAnswer(_moved(1.0, 2.0, 2.0)), given)["joints"][0]
    np.testing.assert_allclose(_points(first), TRUE_MM[KEYS[0]] + (1.0, 2.0, 2.0), atol=1e-3)
    assert first["source"] == "mvexonet"


def test_a_corrected_hand_that_was_kept_is_asked_again(run: Any, scene: Scene) -> None:
    """Joints that did not move, as their round was not believed, have not converged."""
    kept = _joints(1, source="manual")
    earlier = {"joints": kept, "earlier_joints": _joints(0), "corrections": _corrections(scene, KEYS[0], (4,), 2)}
    reasons = [row["reason"] for row in run(KnownAnswer(_moved()), earlier, stop_below_mm=1.0)["rounds"]]
    assert set(reasons) == {""}
