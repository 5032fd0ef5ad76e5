"""The weights in `weights/`: small, readable by this code, and good for hands of people whom no network has seen."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from assemblyhands_core.detectors.base import DetectorError
from assemblyhands_core.detectors.learned import LearnedBody, LearnedHands
from assemblyhands_core.hands.joints import HANDS, ROOT
from assemblyhands_core.models.pretrained import load_hand_keypoints, load_mvexonet
from assemblyhands_core.models.weights_files import read_card
from assemblyhands_core.synthetic.body_keypoints import body_keypoints_mm
from assemblyhands_core.synthetic.crop_boxes import AroundHand
from assemblyhands_core.synthetic.crop_draws import draw_training_take, training_subject
from assemblyhands_core.synthetic.crop_mode import HandViews
from assemblyhands_core.synthetic.render import render_crops

WEIGHTS = Path(__file__).parents[2] / "weights"
MAX_BYTES = 20_000_000
SIZE_PX = 160


@pytest.mark.parametrize("path", sorted(WEIGHTS.glob("*.safetensors")), ids=lambda path: path.stem)
def test_they_are_small_and_say_where_they_come_from(path: Path) -> None:
    card = read_card(path)
    assert path.stat().st_size < MAX_BYTES
    assert {"data", "git commit", "samples", "steps", "training", "config"} <= set(card)
    trained_on = card["data"] + card.get("sequences", "")
    assert any(name in trained_on for name in ("crops_train", "poses_train", "ego_crops_train")), (
        "training subjects alone"
    )


@pytest.fixture(scope="module")
def drawn() -> list[HandViews]:
    """Both hands of two test subjects at an instant each, in γ 1.6 crops of all fixed cameras."""
    found = []
    for subject in (0, 1):
        take = draw_training_take(training_subject("test", subject), subject, num_instants=4, duration_s=4.0)
        studio = take.open()
        found += [studio.hand_views(take.times_s[2], hand, SIZE_PX, AroundHand(1.6)) for hand in HANDS]
    return found


def test_the_2d_network_finds_joints_in_crops(drawn: list[HandViews]) -> None:
    detector, errors = LearnedHands(), []
    for views in drawn:
        for view in np.flatnonzero(views.is_valid):
            seen = detector.detect(views.images[view], views.hand, views.cameras[view].camera_id, 0)
            assert seen is not None
            errors.append(np.linalg.norm(seen.keypoints_px - views.joints_px[view], axis=1))
    assert 0.3 < np.nanmedian(errors) < 0.04 * SIZE_PX
    assert np.isfinite(errors).mean() > 0.85


def test_mvexonet_finds_joints_in_3d(drawn: list[HandViews]) -> None:
    network, errors = load_mvexonet(WEIGHTS / "mvexonet.safetensors"), []
    assert network.config.image_size_px == 128
    for views in drawn:
        root = views.joints_world_mm[ROOT] + np.array([3.0, -2.0, 4.0])
        images = torch.from_numpy(views.images).movedim(-1, 1).float()[None] / 255
        matrices = np.stack([camera.P_pixel_from_world for camera in views.cameras])
        with torch.no_grad():
            found = network(
                images,
                torch.from_numpy(matrices).float()[None],
                torch.from_numpy(views.is_valid)[None],
                torch.from_numpy(root).float()[None],
                torch.tensor([views.hand == "left"]),
            )
        errors.append(np.linalg.norm(found.joints_world_mm[0].numpy() - views.joints_world_mm, axis=1))
    assert 0.3 < np.mean(errors) < 8.0


def test_the_body_network_finds_wrists_and_is_not_mistaken_for_the_hands_network() -> None:
    take = draw_training_take(training_subject("test", 2), 2, num_instants=4, duration_s=4.0)
    instant = take.open().at(take.times_s[1])
    detector, errors = LearnedBody(), []
    cameras = [camera.scaled(480, 270) for camera in instant.sources]
    pictures = render_crops(
        instant.scene, cameras, sensors=instant.sensors, frame_seed=0, background_cache=instant.cache
    )
    for camera, picture in zip(cameras, pictures, strict=True):
        (found,) = detector.detect(picture.image, camera.camera_id, 0).keypoints_px
        true: Any = camera.project(body_keypoints_mm(instant.state)[9:11])
        errors.append(np.linalg.norm(found[9:11] - true, axis=1))
    assert 0.3 < np.nanmedian(errors) < 15.0
    assert load_hand_keypoints(WEIGHTS / "body_keypoints.safetensors").config.num_joints == 17
    with pytest.raises(DetectorError, match=r"body_keypoints.safetensors finds 17 joints, 21 are wanted"):
        LearnedHands(WEIGHTS / "body_keypoints.safetensors")
