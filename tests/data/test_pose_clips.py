"""Poses on a regular time base: instants, gaps between frames, hands that are never seen."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from assemblyhands_core.data.pose_clips import PoseClip, PoseTracks, cut_clip
from assemblyhands_core.hands.graphs import graph_nodes
from assemblyhands_core.hands.joints import JOINT_NAMES, WRIST

CMC, THUMB_MCP = JOINT_NAMES.index("thumb_cmc"), JOINT_NAMES.index("thumb_mcp")


def _joints(times_s: np.ndarray) -> np.ndarray:
    """Joints that move straight: joint j is at (j + 60 t, j², t), in mm with t in seconds."""
    joint = np.arange(42.0)
    moved = joint + 60 * times_s[:, None]
    return np.stack([moved, np.broadcast_to(joint**2, moved.shape), np.broadcast_to(times_s[:, None], moved.shape)], -1)


def _tracks(times_s: np.ndarray, missing: tuple[tuple[int, slice], ...] = ()) -> PoseTracks:
    """Return tracks at some times; `missing` names frames and joints."""
    joints, valid = _joints(times_s), np.ones((len(times_s), 42), dtype=bool)
    for frame, which in missing:
        valid[frame, which], joints[frame, which] = False, 1e6
    return PoseTracks.of(joints, valid, times_s, "skeleton")


def _at(clip: PoseClip) -> np.ndarray:
    """Return the times that a clip's poses are of, by hand, as the third coordinate says."""
    return clip.nodes_mm[:, :, WRIST, 2]


LEFT, RIGHT = slice(21, 42), slice(0, 21)
RATE_30 = np.arange(31) / 30


def test_thirty_hz_of_a_segment_counted_at_sixty() -> None:
    clip = cut_clip(_tracks(RATE_30), 20, 29, rate_hz=30)  # frames 10 to 14 of 30 Hz: 14.5 has no instant
    np.testing.assert_allclose(_at(clip)[:, 0], np.arange(10, 15) / 30, atol=1e-6)
    assert clip.observed.all() and not clip.is_interpolated.any() and clip.coverage == 1.0
    np.testing.assert_array_equal(clip.nodes_mm[0, 1, :, 1], np.arange(21, 42) ** 2)  # the left hand comes second


def test_context_goes_as_far_as_the_recording() -> None:
    clip = cut_clip(_tracks(RATE_30), 10, 50, rate_hz=30, context_keys=25)  # keys -15 to 75 of 0 to 60
    np.testing.assert_allclose(_at(clip)[[0, -1], 0], [0, 1], atol=1e-6)
    assert len(clip) == 31
    assert len(cut_clip(_tracks(RATE_30), 30, 30, rate_hz=30, context_keys=10)) == 11


@pytest.mark.parametrize(("first", "last"), [(61, 90), (-30, -1)])
def test_outside_the_recording_there_are_no_instants(first: int, last: int) -> None:
    clip = cut_clip(_tracks(RATE_30), first, last, rate_hz=30)
    assert len(clip) == 0 and clip.coverage == 0.0 and clip.nodes_mm.shape == (0, 2, 21, 3)


def test_a_segment_of_one_odd_key_has_an_instant() -> None:
    np.testing.assert_allclose(_at(cut_clip(_tracks(RATE_30), 21, 21, rate_hz=30)), [[11 / 30] * 2], atol=1e-6)


def test_poses_at_ten_hz_are_interpolated_and_flagged() -> None:
    clip = cut_clip(_tracks(np.arange(11) / 10), 12, 25, rate_hz=30)  # 0.2 to 0.4 s
    np.testing.assert_allclose(_at(clip)[:, 0], np.arange(6, 13) / 30, atol=1e-6)
    np.testing.assert_array_equal(clip.observed[:, 0], [True, False, False, True, False, False, True])
    np.testing.assert_array_equal(clip.is_interpolated, ~clip.observed)
    assert clip.coverage == pytest.approx(3 / 7)


def test_poses_at_sixty_hz_are_every_second_one() -> None:
    clip = cut_clip(_tracks(np.arange(61) / 60, ((20, RIGHT), (21, RIGHT))), 18, 25, rate_hz=30)
    np.testing.assert_allclose(_at(clip)[:, 0], np.arange(9, 13) / 30, atol=1e-6)  # from frames 19 and 22
    np.testing.assert_array_equal(clip.observed[:, 0], [True, True, True, True])  # 19 is half a step from 20
    clip = cut_clip(_tracks(np.arange(61) / 60, tuple((f, RIGHT) for f in (19, 20, 21))), 18, 25, rate_hz=30)
    np.testing.assert_array_equal(clip.observed, [[True, True], [False, True], [True, True], [True, True]])


def test_gaps_are_bridged_and_ends_are_held() -> None:
    missing = tuple((frame, LEFT) for frame in (10, 12, 13, 16))
    clip = cut_clip(_tracks(RATE_30[:17], missing), 20, 33, rate_hz=30)
    np.testing.assert_allclose(_at(clip)[:, 0], np.arange(10, 17) / 30, atol=1e-6)
    # Frame 9 is looked at, being next to the clip; after 15 there is nothing, so its pose stays.
    np.testing.assert_allclose(_at(clip)[:, 1], np.array([10, 11, 12, 13, 14, 15, 15]) / 30, atol=1e-6)
    np.testing.assert_array_equal(clip.observed[:, 1], [False, True, False, False, True, True, False])
    np.testing.assert_array_equal(clip.is_interpolated[:, 1], ~clip.observed[:, 1])
    assert not clip.is_interpolated[:, 0].any()


def test_a_hand_that_is_never_seen_is_nowhere() -> None:
    missing = tuple((frame, LEFT) for frame in range(5, 20))  # it is seen before and after
    clip = cut_clip(_tracks(RATE_30, missing), 20, 31, rate_hz=30)
    assert np.isnan(clip.nodes_mm[:, 1]).all() and np.isfinite(clip.nodes_mm[:, 0]).all()
    assert not clip.observed[:, 1].any() and not clip.is_interpolated[:, 1].any() and not clip.is_present[:, 1].any()


def test_single_joints_are_bridged_by_themselves() -> None:
    clip = cut_clip(_tracks(RATE_30, tuple((f, slice(3, 5)) for f in (11, 12))), 20, 31, rate_hz=30)
    assert clip.observed.all()
    np.testing.assert_allclose(clip.nodes_mm, _joints(RATE_30)[10:16].reshape(-1, 2, 21, 3), rtol=1e-6)


def test_half_a_hand_is_observed_and_less_is_not() -> None:
    for count, is_seen in ((10, True), (11, False)):
        clip = cut_clip(_tracks(RATE_30, tuple((f, slice(0, count)) for f in range(31))), 20, 31, rate_hz=30)
        assert clip.observed[:, 0].all() == is_seen and clip.observed[:, 0].any() == is_seen


def test_a_joint_that_is_never_known_is_put_between_its_neighbours() -> None:
    clip = cut_clip(_tracks(RATE_30, tuple((f, slice(CMC, CMC + 1)) for f in range(31))), 20, 31, rate_hz=30)
    right = clip.nodes_mm[:, 0]
    np.testing.assert_allclose(right[:, CMC], (right[:, WRIST] + right[:, THUMB_MCP]) / 2, rtol=1e-6)


def test_graph_and_order_of_hands() -> None:
    joints, valid = _joints(RATE_30), np.ones((31, 42), dtype=bool)
    tracks = PoseTracks.of(joints, valid, RATE_30, "landmarks", ("left", "right"))
    np.testing.assert_array_equal(tracks.nodes_mm[:, 0], graph_nodes(joints[:, 21:], "landmarks"))
    np.testing.assert_array_equal(tracks.nodes_mm[:, 1], graph_nodes(joints[:, :21], "landmarks"))


def test_places_between_instants() -> None:
    clip = cut_clip(_tracks(RATE_30, ((12, LEFT),)), 20, 29, rate_hz=30).at(np.array([0.0, 0.5, 2.25, 4.0]))
    np.testing.assert_allclose(_at(clip)[:, 0], np.array([10, 10.5, 12.25, 14]) / 30, atol=1e-6)
    np.testing.assert_array_equal(clip.observed[:, 1], [True, True, False, True])
    np.testing.assert_array_equal(clip.is_interpolated[:, 1], [False, False, True, False])


@pytest.mark.parametrize("times", [[0.0, 0.2, 0.1], [0.0, 0.1, 0.1], [0.0, np.nan, 0.1]])
def test_times_have_to_rise(times: list[float]) -> None:
    with pytest.raises(ValueError, match=r"frame [12] of 3 is at .* sort the frames"):
        PoseTracks(np.zeros((3, 2, 21, 3)), np.array(times), "skeleton")


@given(
    kept=st.lists(st.booleans(), min_size=40, max_size=40),
    first=st.integers(0, 70),
    length=st.integers(0, 40),
    rate_hz=st.sampled_from([10, 30, 60]),
)
@settings(max_examples=60, deadline=None, derandomize=True)
def test_poses_lie_between_what_was_seen(kept: list[bool], first: int, length: int, rate_hz: int) -> None:
    """Whatever is missing, poses are those of an instant of the clip or the frames next to it, and flags add up."""
    missing = tuple((frame, LEFT) for frame, is_kept in enumerate(kept) if not is_kept)
    clip = cut_clip(_tracks(np.arange(40) / 30, missing), first, first + length, rate_hz=rate_hz)
    assert not (clip.observed & clip.is_interpolated).any()
    np.testing.assert_array_equal(clip.is_present, np.isfinite(clip.nodes_mm).all(axis=(2, 3)))
    if clip.is_present[:, 1].any():
        seen_s = np.flatnonzero(kept) / 30
        assert (_at(clip)[:, 1] >= seen_s[0] - 1e-6).all() and (_at(clip)[:, 1] <= seen_s[-1] + 1e-6).all()
        np.testing.assert_array_equal(np.sort(_at(clip)[:, 1]), _at(clip)[:, 1])
    assert (np.abs(_at(clip)[:, 0] * rate_hz - np.rint(_at(clip)[:, 0] * rate_hz)) < 1e-3).all()
