"""Motion: minimum jerk, turns without jumps, and things that are carried."""

import itertools

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from assemblyhands_core.geometry import transforms
from assemblyhands_core.synthetic.motion import (
    PEAK_OVER_MEAN_SPEED,
    WORLD,
    HandKey,
    HandTrack,
    PartKey,
    PartTrack,
    Tracks,
    Tremor,
    about_z,
    interpolated,
    minimum_jerk,
    rotation,
    rotation_vector,
    shifted,
)

STILL = Tremor(0.0, 0.0, tuple((0.0,) * 6 for _ in range(3)))


def key(t_s: float, pose: np.ndarray, frame: str = WORLD, **more: np.ndarray) -> HandKey:
    return HandKey(t_s, frame, pose, np.eye(4), np.zeros(20), **more)


def test_minimum_jerk_begins_and_ends_at_rest_and_peaks_in_the_middle() -> None:
    assert [minimum_jerk(s) for s in (-1.0, 0.0, 0.5, 1.0, 2.0)] == [0.0, 0.0, 0.5, 1.0, 1.0]
    speed = (minimum_jerk(0.5 + 1e-4) - minimum_jerk(0.5 - 1e-4)) / 2e-4
    assert abs(speed - PEAK_OVER_MEAN_SPEED) < 1e-6
    assert minimum_jerk(1e-3) < 1e-7


@settings(max_examples=60, derandomize=True, deadline=None)
@given(st.tuples(*[st.floats(-1.0, 1.0)] * 3), st.floats(1e-3, np.pi - 1e-6))
def test_rotation_vectors_are_undone_by_rotations(axis: tuple[float, ...], angle: float) -> None:
    length = np.linalg.norm(axis)
    vector = np.array(axis) / length * angle if length > 1e-3 else np.array([0.0, angle, 0.0])
    assert_allclose(rotation_vector(rotation(vector)), vector, atol=1e-6)


def test_half_a_turn_has_an_axis() -> None:
    for vector in np.pi * np.eye(3):
        assert_allclose(np.abs(rotation_vector(rotation(vector))), vector, atol=1e-9)
    assert_allclose(rotation_vector(np.eye(3)), 0.0)


def test_half_way_between_two_poses() -> None:
    middle = interpolated(np.eye(4), shifted(10.0) @ about_z(1.0), 0.5)
    assert_allclose(middle, shifted(5.0) @ about_z(0.5), atol=1e-12)


def test_a_hand_is_at_its_keys_at_their_instants_and_half_way_on_an_arc_between() -> None:
    track = HandTrack([key(1.0, shifted(0.0)), key(2.0, shifted(10.0), arc_mm=np.array([0.0, 4.0, 0.0]))], STILL)
    tracks = Tracks({"right": track, "left": track}, {})
    places = [tracks.at(t).T_world_from("right")[:3, 3].tolist() for t in (0.0, 1.0, 1.5, 2.0, 3.0)]
    assert_allclose(places, [[0, 0, 0], [0, 0, 0], [5, 4, 0], [10, 0, 0], [10, 0, 0]], atol=1e-12)


def test_a_hand_in_the_frame_of_a_part_goes_with_it() -> None:
    left = HandTrack([key(0.0, np.eye(4)), key(1.0, shifted(z_mm=50.0) @ about_z(0.7))], STILL)
    right = HandTrack([key(0.0, shifted(8.0), "toy")], STILL)
    toy = PartTrack([PartKey(0.0, "left", shifted(y_mm=3.0))])
    now = Tracks({"right": right, "left": left}, {"toy": toy}).at(0.6)
    assert_allclose(now.T_world_from("right"), now.T_world_from("left") @ shifted(8.0, 3.0), atol=1e-12)


def test_a_turn_between_moving_frames_does_not_jump_where_it_passes_half_a_turn() -> None:
    # The toy turns by 2 rad while the hand comes to it from the other side: naively the shorter way flips on the way.
    left = HandTrack([key(0.0, np.eye(4)), key(1.0, about_z(2.0))], STILL)
    then = about_z(2.0)[:3, :3]
    coming = key(1.0, about_z(2.2), "toy", frame_then=then)
    right = HandTrack([key(0.0, np.eye(4)), coming], STILL)
    tracks = Tracks({"right": right, "left": left}, {"toy": PartTrack([PartKey(0.0, "left", np.eye(4))])})
    turns = [tracks.at(t).T_world_from("right")[:3, :3] for t in np.linspace(0.0, 1.0, 200)]
    steps = [np.linalg.norm(rotation_vector(a.T @ b)) for a, b in itertools.pairwise(turns)]
    assert max(steps) < 0.1
    assert_allclose(turns[-1], about_z(4.2)[:3, :3], atol=1e-12)


def test_a_part_stays_between_carriers_and_moves_within_one() -> None:
    track = PartTrack(
        [PartKey(0.0, WORLD, shifted(1.0)), PartKey(1.0, "a", shifted(2.0)), PartKey(2.0, "a", shifted(4.0))]
    )
    assert [(c, T[0, 3]) for c, T in (track.at(t) for t in (0.9, 1.0, 1.5, 5.0))] == [
        (WORLD, 1.0),
        ("a", 2.0),
        ("a", 3.0),
        ("a", 4.0),
    ]


def test_tremor_is_small_smooth_and_absent_where_it_should_be() -> None:
    tremor = Tremor.from_rng(np.random.default_rng(0))
    poses = np.stack([tremor.at(t, 1.0) for t in np.linspace(0.0, 20.0, 2001)])
    assert 1.0 < np.abs(poses[:, :3, 3]).max() <= 3 * tremor.amplitude_mm
    assert np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=-1).max() / 0.01 < 40.0
    assert_allclose(tremor.at(3.0, 0.0), np.eye(4))
    assert transforms.reason_not_rigid(poses[17]) is None
