"""The skin of synthetic hands: closed, around its joints, following its bones, different from subject to subject."""

import numpy as np
import numpy.typing as npt
import pytest

from assemblyhands_core.geometry import transforms
from assemblyhands_core.hands.grasps import GRASPS, Grasp, grasp_angles_rad
from assemblyhands_core.hands.joints import HANDS, Hand
from assemblyhands_core.hands.kinematics import JOINT_LIMITS_RAD, HandPose, forward_kinematics, mirrored
from assemblyhands_core.synthetic.hand_mesh import PARTS, HandMesh
from assemblyhands_core.synthetic.hand_shape import HandShape

Array = npt.NDArray[np.float64]
AVERAGE = HandMesh.of(HandShape.average(), "right")
SUBJECTS = range(34)


def pose(hand: Hand, grasp: Grasp = "relaxed", T_world_from_wrist: Array | None = None) -> HandPose:
    return HandPose(hand, np.eye(4) if T_world_from_wrist is None else T_world_from_wrist, grasp_angles_rad(grasp))


def turned() -> Array:
    axis = np.array([1.0, 2.0, -2.0]) / 3.0
    cross = np.cross(np.eye(3), axis)
    return transforms.rigid(
        np.eye(3) + np.sin(2.0) * cross + (1 - np.cos(2.0)) * cross @ cross, np.array([80.0, 195, 80])
    )


def volume_cm3(vertices: Array, faces: npt.NDArray[np.int32]) -> float:
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    return float(np.einsum("fi,fi->f", a, np.cross(b, c)).sum() / 6.0 / 1000.0)


def winding_numbers(points: Array, vertices: Array, faces: npt.NDArray[np.int32]) -> Array:
    """How often the skin surrounds points: 0 outside, 1 inside, 2 where it overlaps (Van Oosterom & Strackee)."""
    a, b, c = np.moveaxis(vertices[faces][None] - points[:, None, None], 2, 0)
    la, lb, lc = (np.linalg.norm(corner, axis=-1) for corner in (a, b, c))
    top = np.einsum("pfi,pfi->pf", a, np.cross(b, c))
    dots = [np.einsum("pfi,pfi->pf", *pair) for pair in ((a, b), (b, c), (c, a))]
    bottom = la * lb * lc + dots[0] * lc + dots[1] * la + dots[2] * lb
    return np.arctan2(top, bottom).sum(axis=1) / (2.0 * np.pi)


@pytest.mark.parametrize("hand", HANDS)
def test_the_skin_is_one_closed_surface_that_faces_outwards(hand: Hand) -> None:
    mesh = HandMesh.of(HandShape.from_seed(5), hand)
    edges = np.concatenate([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]], mesh.faces[:, [2, 0]]])
    assert len(np.unique(edges, axis=0)) == len(edges)  # no edge is walked twice in the same sense ...
    assert {tuple(edge) for edge in edges.tolist()} == {tuple(edge[::-1]) for edge in edges.tolist()}  # ... all back
    assert len(mesh.right_rest_mm) - len(edges) // 2 + len(mesh.faces) == 2  # Euler: one sphere, no handle
    assert set(mesh.faces.ravel()) == set(range(len(mesh.right_rest_mm)))
    assert volume_cm3(mesh.skin(pose(hand)), mesh.faces) > 0.0


def test_the_mesh_is_fine_and_even() -> None:
    assert 2500 <= len(AVERAGE.right_rest_mm) <= 6000
    corners = AVERAGE.right_rest_mm[AVERAGE.faces]
    lengths = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=-1)
    assert lengths.min() > 0.5 and lengths.max() < 9.0
    assert (AVERAGE.faces.dtype, AVERAGE.right_rest_mm.dtype) == (np.int32, np.float64)


@pytest.mark.parametrize("seed", SUBJECTS)
def test_every_hand_has_the_volume_and_size_of_a_hand(seed: int) -> None:
    mesh = HandMesh.of(HandShape.from_seed(seed), "right")
    skin = mesh.skin(pose("right", "flat"))
    length = skin[:, 1].max()
    beyond_wrist = skin * [1.0, 0.0, 1.0] + np.maximum(skin[:, 1], 0.0)[:, None] * [0.0, 1.0, 0.0]
    assert 180.0 < volume_cm3(beyond_wrist, mesh.faces) < 500.0
    assert 160.0 < length < 220.0
    fingers = np.isin(mesh.part, [PARTS.index("index"), PARTS.index("pinky"), PARTS.index("palm")])
    knuckles = skin[fingers & (np.abs(skin[:, 1] - 0.42 * length) < 6.0)]
    assert 65.0 < np.ptp(knuckles[:, 0]) < 105.0


def test_the_average_hand_has_the_measures_of_the_literature() -> None:
    skin = AVERAGE.skin(pose("right", "flat"))
    assert skin[:, 1].max() == pytest.approx(188.0, abs=3.0)
    assert 250.0 < volume_cm3(skin, AVERAGE.faces) < 500.0
    index = skin[(AVERAGE.part == PARTS.index("index"))]
    pip = forward_kinematics(AVERAGE.skeleton, pose("right", "flat"))[6]
    assert np.ptp(index[np.abs(index[:, 1] - pip[1]) < 3.0][:, 0]) == pytest.approx(20.0, abs=2.0)


@pytest.mark.parametrize("hand", HANDS)
@pytest.mark.parametrize("grasp", GRASPS)
def test_joints_lie_inside_the_skin(hand: Hand, grasp: Grasp) -> None:
    mesh = HandMesh.of(HandShape.from_seed(GRASPS.index(grasp)), hand)
    placed = pose(hand, grasp, turned())
    joints, skin = forward_kinematics(mesh.skeleton, placed), mesh.skin(placed)
    assert winding_numbers(joints, skin, mesh.faces).min() > 0.99
    under_skin = np.linalg.norm(joints[:, None] - skin, axis=-1).min(axis=1)
    assert under_skin.min() > 3.0
    assert (under_skin[[0, 4, 8, 12, 16]] < 10.0).all()  # the centre of the fingertip
    far_out = joints + np.array([0.0, 0.0, 400.0])
    assert np.abs(winding_numbers(far_out, skin, mesh.faces)).max() < 1e-6


def test_full_flexion_does_not_collapse_the_joints() -> None:
    straight, folded = pose("right", "flat"), HandPose("right", np.eye(4), JOINT_LIMITS_RAD[:, 1])
    under_skin = []
    for placed in (straight, folded):
        joints, skin = forward_kinematics(AVERAGE.skeleton, placed), AVERAGE.skin(placed)
        own = [np.flatnonzero(AVERAGE.part == PARTS.index(finger)) for finger in ("index", "middle", "ring", "pinky")]
        pips = joints[[6, 10, 14, 18]]
        under_skin.append([np.linalg.norm(skin[o] - pip, axis=1).min() for o, pip in zip(own, pips, strict=True)])
    assert (np.array(under_skin[1]) > 0.6 * np.array(under_skin[0])).all()
    fist, flat = (volume_cm3(AVERAGE.skin(placed), AVERAGE.faces) for placed in (folded, straight))
    assert fist == pytest.approx(flat, rel=0.1)


def test_the_skin_moves_rigidly_with_the_wrist() -> None:
    here, there = AVERAGE.skin(pose("right", "power")), AVERAGE.skin(pose("right", "power", turned()))
    assert np.abs(there - transforms.apply(turned(), here)).max() < 1e-9


def test_a_bent_finger_takes_its_own_skin_along_and_leaves_the_others() -> None:
    bent = grasp_angles_rad("flat")
    bent[5:8] += np.deg2rad([60.0, 60.0, 40.0])
    moved = np.linalg.norm(
        AVERAGE.skin(HandPose("right", np.eye(4), bent)) - AVERAGE.skin(pose("right", "flat")), axis=1
    )
    part = np.array(PARTS)[AVERAGE.part]
    assert moved[part == "index"].max() > 60.0
    for still in ("ring", "pinky", "forearm"):
        assert moved[part == still].max() < 2.0
    assert np.median(moved[part == "middle"]) < 0.5


def test_the_stump_turns_to_the_elbow_and_the_hand_does_not() -> None:
    placed = pose("right", "relaxed", turned())
    elbow = transforms.apply(turned(), np.array([0.0, -200.0, 150.0]))
    straight, turned_arm = AVERAGE.skin(placed), AVERAGE.skin(placed, elbow)
    local = transforms.apply(transforms.inverse(turned()), turned_arm)
    end = local[np.argsort(AVERAGE.right_rest_mm[:, 1])[:40]].mean(axis=0)
    assert end / np.linalg.norm(end) @ [0.0, -0.8, 0.6] > 0.99
    hand = AVERAGE.right_rest_mm[:, 1] > 12.0
    assert np.abs(turned_arm - straight)[hand].max() < 1.0
    in_line = AVERAGE.skin(placed, transforms.apply(turned(), np.array([0.0, -250.0, 0.0])))
    assert np.abs(in_line - straight).max() < 1e-9


def test_mistaken_poses_are_refused() -> None:
    with pytest.raises(ValueError, match="mirror the pose"):
        AVERAGE.skin(pose("left"))
    with pytest.raises(ValueError, match="swap wrist and elbow"):
        AVERAGE.skin(pose("right"), np.array([0.0, 250.0, 0.0]))


@pytest.mark.parametrize("grasp", GRASPS)
def test_left_is_the_exact_mirror_image_of_right(grasp: Grasp) -> None:
    shape = HandShape.from_seed(3)
    right, left = HandMesh.of(shape, "right"), HandMesh.of(shape, "left")
    placed = pose("right", grasp, turned())
    elbow = np.array([300.0, 100.0, 50.0])
    mirror = np.array([-1.0, 1.0, 1.0])
    assert (left.skin(mirrored(placed), elbow * mirror) == right.skin(placed, elbow) * mirror).all()
    assert (left.skin(mirrored(placed)) == right.skin(placed) * mirror).all()
    assert (left.faces == right.faces[:, ::-1]).all() and (left.albedo == right.albedo).all()


def test_the_same_seed_gives_the_same_bytes_and_another_another_hand() -> None:
    def made(seed: int) -> bytes:
        mesh = HandMesh.of(HandShape.from_seed(seed), "right")
        return mesh.right_rest_mm.tobytes() + mesh.albedo.tobytes() + mesh.skeleton.bone_lengths_mm.tobytes()

    assert made(7) == made(7)
    assert len({made(seed) for seed in SUBJECTS}) == len(SUBJECTS)


def test_subjects_cover_sizes_and_skin_tones() -> None:
    shapes = [HandShape.from_seed(seed) for seed in SUBJECTS]
    lengths = [shape.skeleton.bone_lengths_mm[8:12].sum() for shape in shapes]
    assert np.ptp(lengths) > 20.0
    backs = [HandMesh.of(shape, "right").albedo.mean(axis=0) for shape in shapes]
    red, _, blue = np.transpose(backs)
    assert red.min() < 0.2 < 0.6 < red.max()
    assert (red > blue).all()  # skin is warm in every tone


def test_nails_palm_and_creases_are_seen() -> None:
    mesh = HandMesh.of(HandShape.from_seed(8), "right")
    assert ((mesh.albedo >= 0.0) & (mesh.albedo <= 1.0)).all()
    nails = np.flatnonzero(mesh.part == PARTS.index("nail"))
    assert 5 * 5 <= len(nails) <= 5 * 40
    skin = mesh.skin(pose("right", "flat"))
    tips = forward_kinematics(mesh.skeleton, pose("right", "flat"))[[0, 4, 8, 12, 16]]
    nearest = np.linalg.norm(skin[nails][:, None] - tips, axis=-1)
    assert nearest.min(axis=1).max() < 20.0 and set(nearest.argmin(axis=1)) == set(range(5))
    palm = mesh.part == PARTS.index("palm")
    below, above = skin[:, 2] < -14.0, skin[:, 2] > 6.0
    assert mesh.albedo[palm & below].mean() > 1.2 * mesh.albedo[palm & above].mean()  # palms are paler in dark hands


def test_weights_are_shares() -> None:
    assert (AVERAGE.weights >= 0.0).all()
    assert AVERAGE.weights.sum(axis=1) == pytest.approx(1.0)
    assert set(AVERAGE.part) == set(range(len(PARTS)))
