"""Whatever is varied in an egocentric crop, pixels, depth and ray say where the joints are."""

from dataclasses import replace

import numpy as np
from ego_crops import ego_crops, hands

from assemblyhands_core.hands.joints import WRIST
from assemblyhands_core.training.ego_dataset import PLAIN, EgoAugmentation, EgoCrops

WILD = EgoAugmentation(0.15, 0.05, 30.0, 0.5, 0.1, 0.01)


def _data(augmentation: EgoAugmentation = WILD, size_px: int = 64, count: int = 8) -> EgoCrops:
    return EgoCrops.of(ego_crops(count), augmentation, size_px, seed=3)


def test_the_brightest_spot_is_where_the_right_or_mirrored_left_wrist_is() -> None:
    """The brightest spot is the right wrist's; in a mirrored crop that is the left one's place in the order."""
    data, mirrored = _data(replace(WILD, gain_spread=0.0, noise_spread=0.0)), 0
    for epoch in range(6):
        for index in np.flatnonzero(data.hand == 0).tolist():  # crops of right hands: their wrists lie inside
            sample = data.sample(index, epoch)
            is_mirrored = bool(sample["is_own"][21])
            mirrored += is_mirrored
            wrist = (21 if is_mirrored else 0) + WRIST
            if not sample["is_valid"][wrist]:
                continue
            grey = sample["images"].mean(axis=-1)
            weights = np.where(grey > 0.85 * grey.max(), grey, 0.0)
            rows, columns = np.mgrid[:64, :64]
            light = np.array([(weights * columns).sum(), (weights * rows).sum()]) / weights.sum()
            assert np.linalg.norm(light - sample["pixels"][wrist]) < 1.0, (epoch, index)
    assert 3 < mirrored < 21


def test_pixels_depth_and_rays_give_back_the_joints() -> None:
    data = _data()
    for index in range(len(data)):
        sample = data.sample(index, turn=1)
        rays = np.concatenate([sample["pixels"], np.ones((42, 1))], axis=1) @ sample["ray_from_pixel"].T.astype(float)
        np.testing.assert_allclose(rays[:, 2], 1.0, atol=1e-5)
        lifted = rays * (sample["depth_mm"] + sample["wrist_depth_mm"])[:, None]
        np.testing.assert_allclose(lifted, sample["joints_camera_mm"], rtol=0, atol=0.05)
        assert sample["depth_mm"][WRIST] == sample["depth_mm"][21 + WRIST] == 0.0


def test_a_mirrored_crop_is_of_the_other_hand_in_a_mirrored_world() -> None:
    plain, flipped = (
        _data(PLAIN, size_px=96).sample(0, 0),
        _data(replace(PLAIN, flip_share=1.0), size_px=96).sample(0, 0),
    )
    np.testing.assert_array_equal(flipped["images"], plain["images"][:, ::-1])
    np.testing.assert_allclose(flipped["pixels"][21:, 0], 95 - plain["pixels"][:21, 0], atol=1e-4)
    np.testing.assert_allclose(flipped["depth_mm"][:21], plain["depth_mm"][21:], atol=1e-4)
    np.testing.assert_allclose(flipped["joints_camera_mm"][21:], plain["joints_camera_mm"][:21] * [-1, 1, 1], atol=1e-4)
    assert (plain["identity"], flipped["identity"]) == (0, 1)
    assert plain["is_own"][:21].all() and flipped["is_own"][21:].all() and not flipped["is_own"][:21].any()
    both = _data(replace(PLAIN, flip_share=1.0)).sample(3, 0)  # of frame 4: frame 3 has no crop
    assert both["identity"] == 2


def test_plain_samples_are_the_stored_crops() -> None:
    data = _data(PLAIN, size_px=96)
    assert len(data) == 7 and data.identity.tolist() == [0, 1, 0, 2, 1, 0, 1]
    sample = data.sample(1, 0)
    np.testing.assert_allclose(sample["joints_camera_mm"].reshape(2, 21, 3), hands(1), atol=1e-3)
    np.testing.assert_array_equal(sample["is_valid"], data.is_labelled[1])
    assert len(data.spread(3)) == 3 and data.spread(3).identity.tolist() == [0, 2, 1]


def test_samples_repeat_and_epochs_differ() -> None:
    first, again, later = _data().sample(2, 0), _data().sample(2, 0), _data().sample(2, 1)
    assert all(np.array_equal(first[name], again[name]) for name in first)
    assert not np.array_equal(first["images"], later["images"])


def test_without_the_wrist_there_is_no_depth() -> None:
    crops = ego_crops(4)
    rows = crops.to_pylist()
    rows[0]["joints_camera_mm"][3 * WRIST : 3 * WRIST + 3] = [np.nan] * 3  # the crop's own hand
    rows[1]["joints_camera_mm"][3 * WRIST : 3 * WRIST + 3] = [np.nan] * 3  # the other one
    data = EgoCrops.of(type(crops).from_pylist(rows, schema=crops.schema), PLAIN, 96, seed=0)
    assert len(data) == 2 and data.hand.tolist() == [1, 0]
    assert not data.is_labelled[0, :21].any() and data.is_labelled[0, 21:].any()
