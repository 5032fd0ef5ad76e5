"""Clips are varied as told and otherwise as they are; screw and unscrew change places in the mirror."""

from collections import Counter
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from assemblyhands_core.data.fine_grained import PAPER_VERBS
from assemblyhands_core.data.pose_clips import PoseClip
from assemblyhands_core.data.pose_sequences import PoseSequenceConfig, sequence_of
from assemblyhands_core.training.verb_dataset import PLAIN, VerbAugmentation, VerbClips, mirrored, mirrored_verb

CONFIG = PoseSequenceConfig(rate_hz=30, context_keys=0, num_frames=16, length="pad", centre="none", scale="none")
WILD = VerbAugmentation(0.3, 0.2, 180.0, (0.0, 1.0, 0.0), 2.0, "relabel", 0.5)
LABELS = [("screw", "bolt"), ("pick up", "wheel"), ("unscrew", ""), ("position", "bolt"), ("remove", "anvil")]


def _clips(count: int = len(LABELS), num_instants: int = 12) -> list[PoseClip]:
    """Clips of random hands that move along x by 10 mm an instant; clip i is 1000 i mm high."""
    rng = np.random.default_rng(0)
    clips = []
    for number in range(count):
        nodes = np.tile(rng.normal(0, 30, (1, 2, 21, 3)), (num_instants, 1, 1, 1))
        nodes[..., 0] += 10 * np.arange(num_instants)[:, None, None]
        nodes[..., 1] += 1000 * number
        observed = np.ones((num_instants, 2), dtype=bool)
        observed[3, 0] = False
        clips.append(PoseClip(nodes.astype(np.float32), observed, ~observed, "skeleton"))
    return clips


def _data(augmentation: VerbAugmentation = PLAIN, config: PoseSequenceConfig = CONFIG, **options: Any) -> VerbClips:
    return VerbClips.of(_clips(), LABELS, PAPER_VERBS, ("wheel", "bolt"), config, augmentation, seed=3, **options)


def test_plain_samples_are_the_clips() -> None:
    data = _data()
    assert len(data) == 5
    for index, clip in enumerate(_clips()):
        sample, expected = data.sample(index, turn=4), sequence_of(clip, CONFIG)
        np.testing.assert_array_equal(sample["poses"], expected.values)
        np.testing.assert_array_equal(sample["is_observed"], expected.observed)
        np.testing.assert_array_equal(sample["is_interpolated"], expected.is_interpolated)
    assert [data.sample(i, 0)["verb"] for i in range(5)] == [2, 0, 5, 1, 4]
    assert [data.sample(i, 0)["noun"] for i in range(5)] == [1, 0, -1, 1, -1]


def test_samples_repeat_and_epochs_differ() -> None:
    first, again, later = _data(WILD).sample(2, 0), _data(WILD).sample(2, 0), _data(WILD).sample(2, 1)
    assert all(np.array_equal(first[name], again[name]) for name in first)
    assert not np.array_equal(first["poses"], later["poses"])


def test_turns_keep_heights_and_shapes() -> None:
    data = _data(replace(PLAIN, turn_deg=180.0))
    angles = []
    for epoch in range(40):
        plain, turned = _data().sample(1, 0)["poses"][:, :12], data.sample(1, epoch)["poses"][:, :12]
        np.testing.assert_allclose(turned[1], plain[1], atol=1e-3)  # along the vertical
        lengths = [np.linalg.norm(poses[:, :, :-1] - poses[:, :, 1:], axis=0) for poses in (plain, turned)]
        np.testing.assert_allclose(*lengths, atol=1e-2)
        step = turned[:, 1, 0, 0] - turned[:, 0, 0, 0]  # 10 mm along x, before it was turned
        assert np.hypot(step[0], step[2]) == pytest.approx(10, abs=1e-3)
        angles.append(np.rad2deg(np.arctan2(-step[2], step[0])))
    assert min(angles) < -90 and max(angles) > 90 and abs(np.mean(angles)) < 60


def test_noise_has_its_size() -> None:
    difference = _data(replace(PLAIN, noise_mm=5.0)).sample(0, 0)["poses"] - _data().sample(0, 0)["poses"]
    assert difference[:, :12].std() == pytest.approx(5.0, rel=0.05) and abs(difference.mean()) < 0.5
    assert not difference[:, 12:].any()  # padding stays zero


def test_crops_leave_a_stretch_of_the_clip() -> None:
    data, starts, lengths = _data(replace(PLAIN, crop_share=0.5)), [], []
    for epoch in range(60):
        sample = data.sample(0, epoch)
        count = int((sample["is_observed"] | sample["is_interpolated"])[:, 1].sum())
        x = sample["poses"][0, :count, 7, 1] - _data().sample(0, 0)["poses"][0, 0, 7, 1]
        assert -1e-3 <= x[0] <= x[-1] <= 110 + 1e-3
        starts.append(x[0])
        lengths.append(x[-1] - x[0])
    assert 55 - 1e-3 <= min(lengths) < 65 and 100 < max(lengths) <= 110
    assert min(starts) < 5 and 30 < max(starts) <= 55


def test_speed_changes_steps_but_not_the_way() -> None:
    data, steps = _data(replace(PLAIN, speed_spread=0.2)), []
    for epoch in range(40):
        sample = data.sample(0, epoch)
        count = int((sample["is_observed"] | sample["is_interpolated"])[:, 1].sum())
        x = sample["poses"][0, :count, 7, 1]
        if count < 16:  # else padding has cut it
            assert x[-1] - x[0] == pytest.approx(110, abs=1e-2)
        steps.append(float(x[1] - x[0]))
    assert min(steps) < 8 and max(steps) > 12 and np.mean(steps) == pytest.approx(10, abs=1.5)


@pytest.mark.parametrize("vertical", [(0.0, 1.0, 0.0), (0.0, 0.0, -2.0), (1.0, 2.0, 3.0)])
def test_the_mirror_stands_upright_and_exchanges_the_hands(vertical: tuple[float, float, float]) -> None:
    clip = _clips(1)[0]
    image = mirrored(clip, vertical)
    up = np.array(vertical) / np.linalg.norm(vertical)
    np.testing.assert_allclose(image.nodes_mm[:, 0] @ up, clip.nodes_mm[:, 1] @ up, atol=1e-3)  # heights stay
    np.testing.assert_array_equal(image.observed[:, ::-1], clip.observed)

    def handedness(hand: np.ndarray) -> float:
        return float(np.linalg.det(hand[:3] - hand[3]))

    assert handedness(image.nodes_mm[0, 0]) == pytest.approx(-handedness(clip.nodes_mm[0, 1]), rel=1e-3)
    np.testing.assert_allclose(mirrored(image, vertical).nodes_mm, clip.nodes_mm, atol=1e-3)


def test_screw_and_unscrew_change_places_in_the_mirror() -> None:
    assert [PAPER_VERBS[mirrored_verb(verb, PAPER_VERBS)] for verb in range(6)] == [
        "pick up", "position", "unscrew", "put down", "remove", "screw",
    ]  # fmt: skip
    assert mirrored_verb(0, ("screw", "remove")) == 0


@pytest.mark.parametrize(
    ("mirroring", "expected", "is_mirrored"),
    [
        ("off", [2, 0, 5, 1, 4], [False] * 5),
        ("acyclic", [2, 0, 5, 1, 4], [False, True, False, True, True]),
        ("relabel", [5, 0, 2, 1, 4], [True] * 5),
    ],
)
def test_mirroring_leaves_cyclic_verbs_alone_or_renames_them(
    mirroring: Any, expected: list[int], is_mirrored: list[bool]
) -> None:
    data = _data(replace(PLAIN, mirroring=mirroring, mirror_share=1.0))
    samples = [data.sample(index, 0) for index in range(5)]
    assert [sample["verb"] for sample in samples] == expected
    for index, clip in enumerate(_clips()):
        shown = mirrored(clip, PLAIN.vertical) if is_mirrored[index] else clip
        np.testing.assert_allclose(samples[index]["poses"], sequence_of(shown, CONFIG).values, atol=1e-3)
        assert samples[index]["is_observed"][3].tolist() == ([True, False] if is_mirrored[index] else [False, True])


def test_a_cyclic_verb_without_its_counterpart_is_never_mirrored() -> None:
    augmentation = replace(PLAIN, mirroring="relabel", mirror_share=1.0)
    data = VerbClips.of(_clips(1), LABELS[:1], ("screw", "remove"), (), CONFIG, augmentation, seed=0)
    assert data.sample(0, 0)["verb"] == 0
    np.testing.assert_allclose(data.sample(0, 0)["poses"], sequence_of(_clips(1)[0], CONFIG).values, atol=1e-3)


def test_the_share_that_is_mirrored() -> None:
    data = _data(replace(PLAIN, mirroring="relabel", mirror_share=0.25))
    count = sum(data.sample(0, epoch)["verb"] == 5 for epoch in range(200))
    assert 30 < count < 70


def test_rare_verbs_occur_more_often_each_time_differently() -> None:
    data = _data(WILD, oversampling={"screw": 3, "unscrew": 2})
    assert len(data) == 8 and data.order.tolist() == [0, 0, 0, 1, 2, 2, 3, 4]
    first, second = data.sample(0, 0), data.sample(1, 0)
    assert not np.array_equal(first["poses"], second["poses"])
    assert len(data.spread(4)) == 4 and data.spread(4).order.tolist() == [0, 0, 2, 4]


def test_a_control_has_the_same_verbs_elsewhere() -> None:
    clips = _clips(1) * 60
    data = VerbClips.of(clips, [LABELS[i % 3] for i in range(60)], PAPER_VERBS, (), CONFIG, PLAIN, seed=0)
    control = data.shuffled(seed=1)
    assert Counter(control.verb.tolist()) == Counter(data.verb.tolist())
    assert 0.15 < float((control.verb == data.verb).mean()) < 0.55


def test_clips_without_hands_are_left_out() -> None:
    clips = _clips()
    clips[1] = replace(clips[1], observed=np.zeros((12, 2), dtype=bool), is_interpolated=np.zeros((12, 2), dtype=bool))
    clips[2] = PoseClip(np.zeros((0, 2, 21, 3), np.float32), *[np.zeros((0, 2), dtype=bool)] * 2, "skeleton")
    data = VerbClips.of(clips, LABELS, PAPER_VERBS, (), CONFIG, WILD, seed=0)
    assert len(data) == 3 and data.verb.tolist() == [2, 1, 4]


def test_a_hand_that_is_not_seen_stays_zero_whatever_is_varied() -> None:
    clip = _clips(1)[0]
    clip.nodes_mm[:, 0], clip.observed[:, 0], clip.is_interpolated[:, 0] = np.nan, False, False
    data = VerbClips.of([clip], LABELS[1:2], PAPER_VERBS, (), replace(CONFIG, length="resample"), WILD, seed=0)
    for epoch in range(8):
        sample = data.sample(0, epoch)
        unseen = 0 if sample["is_observed"][:, 1].any() else 1
        assert not sample["poses"][..., unseen].any() and sample["poses"][..., 1 - unseen].all()


@pytest.mark.parametrize(
    ("options", "reason"),
    [({"oversampling": {"dance": 2}}, "'dance' are to occur 2"), ({"oversampling": {"screw": 0}}, "occur 0 times")],
)
def test_oversampling_of_what_is_none(options: dict[str, Any], reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        _data(**options)


def test_clips_of_other_verbs_and_augmentations_that_are_none() -> None:
    with pytest.raises(ValueError, match="1 clips show 'shake'"):
        VerbClips.of(_clips(1), [("shake", "")], PAPER_VERBS, (), CONFIG, PLAIN, seed=0)
    with pytest.raises(ValueError, match="has no direction"):
        replace(PLAIN, vertical=(0.0, 0.0, 0.0))
    with pytest.raises(ValueError, match=r"crop_share=1\.5"):
        replace(PLAIN, crop_share=1.5)
