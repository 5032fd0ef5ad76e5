"""What is said to be true of a take is what its pictures show, for several people, toys and both rigs.

A flag is found along the exact ray to the joint, the id mask along those through the middles of pixels, which pass a
joint at half a millimetre on average: at outlines the two may differ, no more often than in `AT_OUTLINES` of all cases.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from assemblyhands_core.geometry import transforms
from assemblyhands_core.hands.joints import HANDS, Hand
from assemblyhands_core.hands.kinematics import HandPose, bone_lengths_mm, forward_kinematics, is_within_limits
from assemblyhands_core.synthetic.activities import VERBS
from assemblyhands_core.synthetic.bodies import Body
from assemblyhands_core.synthetic.crop_boxes import AroundHand
from assemblyhands_core.synthetic.crop_mode import CropStudio, HandViews
from assemblyhands_core.synthetic.figure import HAND_IDS
from assemblyhands_core.synthetic.hand_mesh import HandMesh
from assemblyhands_core.synthetic.motion import rotation_vector
from assemblyhands_core.synthetic.person import Subject
from assemblyhands_core.synthetic.rig import RIGS
from assemblyhands_core.synthetic.take import MAX_JOINT_SPEED_MM_S, Take
from assemblyhands_core.synthetic.visibility import TOLERANCE_MM

AT_OUTLINES = 0.01
CROP_PX = 128
TIMES_S = (2.0, 5.3)
RATE_HZ = 30.0
GLOVES = (0.05, 0.16, 0.42)


@dataclass(frozen=True, eq=False)
class Look:
    """One hand at one instant, and all of its skin (and glove)."""

    take: Take
    views: HandViews
    skin: tuple[Body, ...]

    @property
    def hand(self) -> Hand:
        """Which."""
        return self.views.hand

    @property
    def ids(self) -> np.ndarray:
        """What the mask shows at each joint in a crop, -1 elsewhere."""
        x, y = np.moveaxis(np.rint(np.where(self.views.is_in_crop[..., None], self.views.joints_px, 0.0)), -1, 0)
        shown = np.stack(
            [mask[v, u] for mask, u, v in zip(self.views.object_id, x.astype(int), y.astype(int), strict=True)]
        )
        return np.where(self.views.is_in_crop, shown.astype(int), -1)


@pytest.fixture(scope="module")
def takes(screwing_take: Take, desk_take: Take) -> list[Take]:
    """Both rigs, and someone left-handed who wears gloves."""
    left_handed = Take.from_seed(0, 41, 11.0)
    assert left_handed.subject.dominant == "left"
    return [screwing_take, desk_take, replace(left_handed, subject=replace(left_handed.subject, gloves=GLOVES))]


@pytest.fixture(scope="module")
def poses(takes: Sequence[Take]) -> list[dict[Hand, HandPose]]:
    """Some seconds of both hands of every take."""
    found = []
    for take in takes:
        instants = [take.tracks.at(n / RATE_HZ) for n in range(int(5.0 * RATE_HZ))]
        places = {hand: np.stack([now.T_world_from(hand) for now in instants]) for hand in HANDS}
        angles = {hand: np.stack([now.angles_rad(hand) for now in instants]) for hand in HANDS}
        found.append({hand: HandPose(hand, places[hand], angles[hand]) for hand in HANDS})
    return found


@pytest.fixture(scope="module")
def looks(takes: Sequence[Take]) -> list[Look]:
    """Both hands at some instants of every take: all fixed cameras and those of the headset that look down."""
    found = []
    for take in takes:
        rig = RIGS[take.kind](11)
        studio = CropStudio.of(take, rig, 11, [*rig.exo, *list(rig.ego)[2:]])
        for t_s in TIMES_S:
            instant = studio.at(t_s)
            for hand in HANDS:
                views = instant.hand_views(hand, CROP_PX, AroundHand(1.3))
                skin = tuple(body for body in instant.scene.moving if body.object_id == HAND_IDS[hand])
                found.append(Look(take, views, skin))
    return found


def test_visible_joints_lie_on_pixels_of_their_hand(looks: Sequence[Look]) -> None:
    for look in looks:
        is_shown = look.views.is_visible & look.views.is_in_crop
        assert is_shown.sum() > 40
        assert np.mean(look.ids[is_shown] == HAND_IDS[look.hand]) >= 0.95
    share = [look.ids[look.views.is_visible & look.views.is_in_crop] == HAND_IDS[look.hand] for look in looks]
    assert np.concatenate(share).mean() > 1 - AT_OUTLINES


def test_right_and_left_are_never_confused(looks: Sequence[Look]) -> None:
    num_other, num_shown = 0, 0
    for look in looks:
        is_shown = look.views.is_visible & look.views.is_in_crop
        other = HAND_IDS["left" if look.hand == "right" else "right"]
        num_other += int((look.ids[is_shown] == other).sum())
        num_shown += int(is_shown.sum())
    assert num_shown > 1000
    assert num_other <= 0.003 * num_shown  # the outline of one hand in front of the other
    hidden = [look.ids[~look.views.is_visible & look.views.is_in_crop] for look in looks]
    both = {HAND_IDS[hand] for hand in HANDS}
    assert all((np.concatenate(hidden) == one).any() for one in both)  # hands do hide one another


def test_occlusion_flags_follow_from_mask_and_skin(looks: Sequence[Look]) -> None:
    """A joint is visible if the mask shows its hand and its own skin is at most so far in front of it."""
    agree, num_hidden_by_itself = [], 0
    for look in looks:
        for view in range(0, len(look.views.cameras), 3):
            is_in = look.views.is_in_crop[view]
            depth = depth_below_skin_mm(look, view)
            is_own = look.ids[view] == HAND_IDS[look.hand]
            expected = is_own & (depth <= TOLERANCE_MM)
            agree.append((expected == look.views.is_visible[view])[is_in])
            num_hidden_by_itself += int((is_own & ~look.views.is_visible[view]).sum())
    assert np.concatenate(agree).mean() > 1 - AT_OUTLINES
    assert num_hidden_by_itself > 100


def test_joints_shown_as_something_else_are_flagged_hidden(looks: Sequence[Look]) -> None:
    other = np.concatenate([(look.ids != HAND_IDS[look.hand])[look.views.is_in_crop] for look in looks])
    visible = np.concatenate([look.views.is_visible[look.views.is_in_crop] for look in looks])
    assert other.sum() > 200
    assert visible[other].mean() < 0.04  # at outlines, which are a larger share of these
    assert 0.05 < other.mean() < 0.6 and 0.3 < visible.mean() < 0.8  # heavy occlusion, as with the real toys


def test_occlusion_rates_are_those_of_heavy_occlusion(looks: Sequence[Look]) -> None:
    rates = [look.views.occlusion_rate for look in looks]
    assert 0.2 < min(rates) < max(rates) < 0.8 and np.ptp(rates) > 0.1
    for look in looks:  # a few joints lie in the picture's rectified crop but not in the picture
        is_in = look.views.is_in_crop
        assert look.views.occlusion_rate == pytest.approx(1.0 - look.views.is_visible[is_in].mean(), abs=0.03)


def test_bones_and_limits_hold_for_everyone(takes: Sequence[Take], poses: Sequence[dict[Hand, HandPose]]) -> None:
    for take, hands in zip(takes, poses, strict=True):
        state = take.state_at(2.0)
        for hand, shown in zip(HANDS, state.joints_world_mm.reshape(2, 21, 3), strict=True):
            joints = forward_kinematics(take.subject.hand_shape.skeleton, hands[hand])
            assert_allclose(joints[int(2.0 * RATE_HZ)], shown)
            expected = np.broadcast_to(take.subject.hand_shape.skeleton.bone_lengths_mm, (len(joints), 20))
            assert_allclose(bone_lengths_mm(joints), expected, rtol=1e-9)
            assert is_within_limits(hands[hand].angles_rad)
        assert max(np.ptp(pose.angles_rad, axis=0).max() for pose in hands.values()) > np.radians(20.0)


def test_nobody_is_faster_than_stated(takes: Sequence[Take], poses: Sequence[dict[Hand, HandPose]]) -> None:
    for take, hands in zip(takes, poses, strict=True):
        joints = [forward_kinematics(take.subject.hand_shape.skeleton, hands[hand]) for hand in HANDS]
        speed = np.linalg.norm(np.diff(np.stack(joints), axis=1), axis=-1) * RATE_HZ
        assert 300.0 < speed.max() < MAX_JOINT_SPEED_MM_S


def test_34_pairs_of_hands_differ_in_shape_and_tone() -> None:
    people = [Subject.from_seed(seed) for seed in range(34)]
    meshes = [HandMesh.of(person.hand_shape, "right") for person in people]
    sizes = np.array([np.ptp(mesh.right_rest_mm, axis=0) for mesh in meshes])
    tones = np.array([mesh.albedo.mean(axis=0) for mesh in meshes])
    looks = np.concatenate([sizes / 1.0, tones / 0.01], axis=1)  # what a picture can tell: a millimetre, a grey level
    apart = np.abs(looks[:, None] - looks[None]).max(axis=-1)[~np.eye(34, dtype=bool)]
    assert apart.min() > 1.0
    assert np.ptp(sizes[:, 1]) > 15.0 and tones[:, 0].max() > 1.8 * tones[:, 0].min()
    assert {person.sleeve for person in people} == {"short", "half", "long"}


def test_actions_last_as_long_as_designed(take: Take, takes: Sequence[Take]) -> None:
    """Medians as over 42 takes of 40 s; those of the few actions of these takes may be off by a factor."""
    lasting: dict[str, list[float]] = {verb: [] for verb in VERBS}
    for one in (take, *takes):
        for segment in one.segments:
            if segment.end_s < one.duration_s:
                lasting[segment.verb].append(segment.end_s - segment.start_s)
    assert all(lasting[verb] for verb in VERBS)
    for verb, (median, longest) in DESIGNED_S.items():
        assert 0.5 * median < np.median(lasting[verb]) < 2.0 * median, verb
        assert max(lasting[verb]) < longest, verb
    turning = lasting["screw"] + lasting["unscrew"]
    others = [seconds for verb in VERBS[:4] for seconds in lasting[verb]]
    assert np.median(turning) > 2.0 * np.median(others) and len(turning) < 0.5 * len(others)


DESIGNED_S = {
    "pick up": (1.2, 4.0),
    "position": (1.5, 5.0),
    "put down": (0.9, 3.0),
    "remove": (1.8, 5.0),
    "screw": (5.1, 20.0),
    "unscrew": (5.4, 20.0),
}
"""Verb: median and more than the longest."""


def test_screws_turn_clockwise_in_and_anticlockwise_out(takes: Sequence[Take]) -> None:
    senses = {"screw": -1.0, "unscrew": 1.0}  # about the outward axis
    num_turned = dict.fromkeys(senses, 0)
    for take in takes:
        for segment in take.segments:
            if segment.verb in senses and segment.end_s < take.duration_s:
                assert senses[segment.verb] * turned_rad(take, segment.part, segment.start_s, segment.end_s) > 1.5
                num_turned[segment.verb] += 1
    assert min(num_turned.values()) >= 1


def turned_rad(take: Take, name: str, start_s: float, end_s: float) -> float:
    """How far a part turns about its z axis against what it is mounted on."""
    mount = take.parts.parts[name].mount
    assert mount is not None
    poses = [take.tracks.at(t) for t in np.arange(start_s, end_s, 0.05).tolist()]
    turns = [(transforms.inverse(p.T_world_from(mount.parent)) @ p.T_world_from(name))[:3, :3] for p in poses]
    steps = [rotation_vector(b @ a.T) @ a[:, 2] for a, b in itertools.pairwise(turns)]
    return float(np.sum(steps))


def depth_below_skin_mm(look: Look, view: int) -> np.ndarray:
    """How far in front of each joint its own skin is first met, by brute force over all faces (Möller and Trumbore)."""
    center = look.views.cameras[view].center_world_mm
    towards = look.views.joints_world_mm - center
    distances = np.linalg.norm(towards, axis=-1)
    nearest = np.full(len(distances), np.inf)
    for body in look.skin:
        a, b, c = (body.vertices_mm[body.faces[:, k]].astype(np.float64) for k in range(3))
        u, v, s = b - a, c - a, center - a
        for joint, ray in enumerate(towards / distances[:, None]):
            p, q = np.cross(ray, v), np.cross(s, u)
            volume = np.einsum("fk,fk->f", u, p)
            volume = np.where(np.abs(volume) < 1e-12, np.inf, volume)
            first, second = np.einsum("fk,fk->f", s, p) / volume, (q @ ray) / volume
            along = np.einsum("fk,fk->f", v, q) / volume
            is_met = (first >= 0) & (second >= 0) & (first + second <= 1) & (along > 0) & np.isfinite(volume)
            nearest[joint] = min(nearest[joint], np.min(along[is_met], initial=np.inf))
    return np.asarray(distances - nearest)
