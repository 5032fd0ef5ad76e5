"""What a round shows to its network and makes of what it says."""

from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from round_scene import (
    KEYS,
    SIZE_PX,
    TRUE_MM,
    KnownAnswer,
    Scene,
    center_of,
    crops_table,
    joints_table,
    keypoints_table,
    points_of,
    side_of,
    truth_moved,
)

from assemblyhands_core.data.catalog import KEYPOINTS
from assemblyhands_core.hands.joints import ROOT
from stages.annotate_round import BlendConfig


def projected(P: Any, point: np.ndarray) -> np.ndarray:
    x, y, depth = np.asarray(P) @ np.append(point, 1.0)
    return np.array([x, y]) / depth


def focal_of(P: Any) -> float:
    x, _, z = np.asarray(P)[:, :3]
    return float(np.linalg.norm(x - (x @ z) * z))


def test_a_round_gives_what_the_network_says(run: Any) -> None:
    network = KnownAnswer(truth_moved(1.0, 2.0, 2.0))
    tables = run(network)
    assert [(row["frame"], row["hand"]) for row in tables["joints"]] == KEYS
    assert [bool(seen[4]) for seen in network.seen] == [hand == "left" for _, hand in KEYS]
    for key, row, detail in zip(KEYS, tables["joints"], tables["rounds"], strict=True):
        np.testing.assert_allclose(points_of(row), TRUE_MM[key] + (1.0, 2.0, 2.0), atol=1e-3)
        assert all(row["valid"]) and set(row["reason"]) == {""} and set(row["num_views"]) == {4}
        assert (row["round"], row["source"]) == (1, "mvexonet")
        assert (detail["round"], detail["kept_round"], detail["num_views"], detail["reason"]) == (1, 1, 4, "")
        assert detail["displacement_mm"] == pytest.approx(3.0, abs=1e-3) and not detail["is_crop_outside"]
        assert detail["confidence"] == pytest.approx(0.9) and detail["note"] == ""


def test_what_is_believed_is_mixed_with_triangulated_joints_near_by(run: Any) -> None:
    """10 mm off, and triangulated joints on the truth: a share of 0.4 leaves 6 mm."""
    answer, mix = truth_moved(0.0, 6.0, 8.0), BlendConfig(share=0.4, within_mm=10.5)
    for row, key in zip(run(KnownAnswer(answer), blend=mix)["joints"], KEYS, strict=True):
        np.testing.assert_allclose(points_of(row), TRUE_MM[key] + (0.0, 3.6, 4.8), atol=1e-3)
        assert row["source"] == "mvexonet" and np.mean(row["reprojection_px"]) > 0.1
    for changed, inputs in (
        ({"blend": BlendConfig(share=0.4, within_mm=9.5)}, {}),
        ({"blend": mix}, {"triangulated": joints_table(missing=tuple(range(21)))}),
    ):
        for row, key in zip(run(KnownAnswer(answer), inputs, **changed)["joints"], KEYS, strict=True):
            np.testing.assert_allclose(points_of(row), TRUE_MM[key] + (0.0, 6.0, 8.0), atol=1e-3)


def test_the_reprojection_of_a_mixed_joint_is_its_own(run: Any) -> None:
    alone, mixed = (
        run(KnownAnswer(truth_moved(0.0, 6.0, 8.0)), blend=BlendConfig(share=share, within_mm=20.0))["joints"]
        for share in (0.0, 0.5)
    )
    ratios = [np.divide(b["reprojection_px"], a["reprojection_px"]) for a, b in zip(alone, mixed, strict=True)]
    np.testing.assert_allclose(ratios, 0.5, atol=0.02)


def test_round_1_looks_at_the_detected_boxes_around_the_triangulated_root(run: Any, scene: Scene) -> None:
    network = KnownAnswer(truth_moved())
    assert {row["box_source"] for row in run(network)["rounds"]} == {"detected"}
    for key, (_, matrices, is_used, root, _) in zip(KEYS, network.seen, strict=True):
        np.testing.assert_allclose(root, TRUE_MM[key][ROOT], atol=1e-4)
        assert is_used.all()
        for P, camera in zip(matrices, scene.rectified.values(), strict=True):
            np.testing.assert_allclose(projected(P, center_of(key)), (SIZE_PX - 1) / 2, atol=2e-3)
            assert focal_of(P) == pytest.approx(camera.fx_px * SIZE_PX / side_of(camera, key), rel=1e-5)


def test_later_rounds_look_at_the_joints_of_the_round_before(run: Any) -> None:
    shift_mm = np.array([6.0, -8.0, 4.0])
    network = KnownAnswer(truth_moved())
    rounds = run(network, {"joints": joints_table(1, shift_mm, source="mvexonet")})["rounds"]
    assert {row["box_source"] for row in rounds} == {"joints"} and {row["round"] for row in rounds} == {2}
    for key, (_, matrices, _, root, _) in zip(KEYS, network.seen, strict=True):
        np.testing.assert_allclose(root, TRUE_MM[key][ROOT] + shift_mm, atol=1e-4)
        for P in matrices:
            pixels = np.stack([projected(P, point) for point in TRUE_MM[key] + shift_mm])
            lower, upper = pixels.min(axis=0), pixels.max(axis=0)
            np.testing.assert_allclose((lower + upper) / 2, (SIZE_PX - 1) / 2, atol=1e-2)
            assert (upper - lower).max() == pytest.approx(SIZE_PX / 1.5, abs=1e-2)


@pytest.mark.parametrize("number", [0, 1])
def test_matrices_say_where_things_are_in_the_pictures(run: Any, number: int) -> None:
    """A blob drawn at the root is where the window's matrix projects the root."""
    network = KnownAnswer(truth_moved())
    run(network, {"joints": joints_table(number)})
    for key, (images, matrices, _, _, _) in zip(KEYS, network.seen, strict=True):
        for image, P in zip(images.numpy(), matrices, strict=True):
            weight = np.where(image[0] > 0.1, image[0], 0.0)
            y, x = np.mgrid[:SIZE_PX, :SIZE_PX]
            found = np.array([(x * weight).sum(), (y * weight).sum()]) / weight.sum()
            np.testing.assert_allclose(found, projected(P, TRUE_MM[key][ROOT]), atol=0.1)


def test_with_few_joints_the_detected_box_and_without_root_the_bodys_centre_is_taken(run: Any) -> None:
    network = KnownAnswer(truth_moved())
    few = joints_table(1, missing=tuple(range(11)))
    assert {row["box_source"] for row in run(network, {"joints": few})["rounds"]} == {"detected"}
    network = KnownAnswer(truth_moved())
    no_root = joints_table(1, missing=(ROOT,))
    assert {row["box_source"] for row in run(network, {"joints": no_root})["rounds"]} == {"joints"}
    for key, seen in zip(KEYS, network.seen, strict=True):
        np.testing.assert_allclose(seen[3], center_of(key), atol=1e-4)


def test_views_without_a_crop_are_not_used_and_with_too_few_a_hand_keeps_its_joints(run: Any, scene: Scene) -> None:
    network = KnownAnswer(truth_moved())
    tables = run(network, {"crops": crops_table(scene.rectified, ("b",))})
    assert all(seen[2].sum() == 3 for seen in network.seen)
    assert all(set(row["num_views"]) == {3} and all(row["valid"]) for row in tables["joints"])
    network = KnownAnswer(truth_moved())
    tables = run(network, {"crops": crops_table(scene.rectified, ("a", "b", "c"))})
    assert not network.seen
    for row, detail in zip(tables["joints"], tables["rounds"], strict=True):
        assert row["source"] == "kept_round_0" and all(row["valid"])
        assert (detail["reason"], detail["note"]) == ("too_few_views", "1 views, 2 are needed")
        assert detail["num_views"] == 1 and np.isnan(detail["confidence"])
    tables = run(network, {"crops": crops_table(scene.rectified, ("a", "b", "c"))}, min_views=1)
    assert all(all(row["valid"]) for row in tables["joints"])


def test_a_hand_that_nobody_can_place_has_its_reason(run: Any, scene: Scene) -> None:
    boxes = scene.inputs["hand_boxes"]
    place = boxes.schema.get_field_index("hand_center_world_mm")
    nowhere = pa.array([[np.nan] * 3] * boxes.num_rows, boxes.schema.field(place).type)
    unknown = {"hand_boxes": boxes.set_column(place, boxes.schema.field(place), nowhere)}
    rows = run(KnownAnswer(truth_moved()), unknown | {"joints": joints_table(missing=(ROOT,))})
    assert {row["reason"] for row in rows["rounds"]} == {"no_root"}
    assert all(row["reason"][ROOT] != "" and row["source"] == "kept_round_0" for row in rows["joints"])
    assert {row["reason"] for row in run(KnownAnswer(truth_moved()), unknown)["rounds"]} == {""}


def test_windows_that_leave_the_stored_crop_say_so(run: Any) -> None:
    """The stored crop is 390 mm wide around the hand."""
    rounds = run(KnownAnswer(truth_moved(0.0, 90.0, 0.0)), {"joints": joints_table(1, (0.0, 90.0, 0.0))})["rounds"]
    assert all(row["is_crop_outside"] and row["num_views"] == 4 for row in rounds)
    tables = run(KnownAnswer(truth_moved()), {"joints": joints_table(1, (0.0, 300.0, 0.0))})
    assert {row["reason"] for row in tables["rounds"]} == {"too_few_views"}


def test_joints_that_the_network_is_not_sure_of_are_missing(run: Any) -> None:
    tables = run(KnownAnswer(truth_moved(), confidence=0.09))
    assert {row["source"] for row in tables["joints"]} == {"kept_round_0"}
    assert {(row["reason"], row["kept_round"]) for row in tables["rounds"]} == {("low_confidence", 0)}
    assert tables["rounds"][0]["confidence"] == pytest.approx(0.09)
    nothing = run(KnownAnswer(truth_moved(), confidence=0.09), {"joints": joints_table(missing=tuple(range(21)))})[
        "joints"
    ]
    assert all(set(row["reason"]) == {"low_confidence"} and np.isnan(points_of(row)).all() for row in nothing)


def test_reprojection_is_against_the_keypoints_in_the_videos_own_pixels(run: Any, scene: Scene) -> None:
    tables = run(KnownAnswer(truth_moved()), {"keypoints": keypoints_table(scene.cameras, (3.0, -4.0))})
    assert all(np.allclose(row["reprojection_px"], 5.0, atol=1e-3) for row in tables["joints"])
    none = run(KnownAnswer(truth_moved()), {"keypoints": KEYPOINTS.empty()})["joints"]
    assert all(np.isnan(row["reprojection_px"]).all() and all(row["valid"]) for row in none)
