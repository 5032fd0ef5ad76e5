"""The few-line interface gives what the network gives for the same crop, in the picture's own pixels and in mm."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from ego_crops import CAMERA, hands, picture

from assemblyhands_core.geometry.distortion import OVFishEye62
from assemblyhands_core.hands.joints import WRIST
from assemblyhands_core.hands.kinematics import HandSkeleton, bone_lengths_mm
from assemblyhands_core.infer import HandPredictor
from assemblyhands_core.models.ego_prediction import predict_hands
from assemblyhands_core.models.pretrained import save_weights
from assemblyhands_core.models.svegonet import SVEgoNet, SVEgoNetConfig

BOX = (20.0, 22.0, 70.0, 64.0)


@pytest.fixture(scope="module")
def predictor(tmp_path_factory: pytest.TempPathFactory) -> HandPredictor:
    torch.manual_seed(0)
    network, path = SVEgoNet(SVEgoNetConfig("mobilenetv3_small_050", 2, 8, 64, 8)).eval(), tmp_path_factory.mktemp("n")
    with torch.no_grad():
        network.head[-1].weight.mul_(100.0)
    save_weights(path / "net.safetensors", network, {})
    return HandPredictor(path / "net.safetensors")


def test_joints_project_to_their_pixels_at_the_wrists_depth(predictor: HandPredictor) -> None:
    found = predictor.predict(picture(hands(0)), CAMERA, BOX, "right", wrist_depth_mm=350.0)
    np.testing.assert_allclose(CAMERA.project(found.joints_camera_mm), found.joints_px, rtol=0, atol=1e-3)
    np.testing.assert_allclose(found.joints_camera_mm[:, 2] - 350.0, found.depth_mm, rtol=0, atol=1e-3)
    center, side = np.array([45.0, 43.0]), 1.75 * 50.0
    assert (np.abs(found.joints_px - center) <= side / 2 + 1.0).all() and np.ptp(found.joints_px) > 5.0
    other = predictor.predict(picture(hands(0)), CAMERA, BOX, "left", wrist_depth_mm=350.0)
    assert found.identity == other.identity and not np.allclose(found.joints_px, other.joints_px)


def test_it_sees_what_the_pipeline_sees_in_the_same_crop(predictor: HandPredictor) -> None:
    """A box whose square is the middle of the picture, of the network's own size: no pixel is sampled anew."""
    image, half = picture(hands(0)), 32.0
    side = 2 * half / 1.75
    box = (47.5 - side / 2, 47.5 - side / 2, 47.5 + side / 2, 47.5 + side / 2)
    found = predictor.predict(image, CAMERA, box, "right", wrist_depth_mm=350.0)
    crop = np.ascontiguousarray(image[16:80, 16:80])
    seen = predict_hands(predictor._network, [crop], ["right"], batch_size=1, num_threads=1)
    np.testing.assert_allclose(found.joints_px, seen.pixels[0] + 16.0, rtol=0, atol=1e-3)
    np.testing.assert_allclose(found.depth_mm, seen.depth_mm[0], rtol=0, atol=1e-3)
    np.testing.assert_allclose(found.confidence, seen.confidence[0], rtol=0, atol=1e-5)


def test_without_a_depth_the_hand_has_a_mean_hands_size(predictor: HandPredictor) -> None:
    found = predictor.predict(picture(hands(0)), CAMERA, BOX, "right")
    size_mm = HandSkeleton.average().bone_lengths_mm.sum()
    wrist_mm = found.joints_camera_mm[WRIST, 2] - found.depth_mm[WRIST]
    found_mm = bone_lengths_mm(found.joints_camera_mm).sum()
    assert found_mm == pytest.approx(size_mm, rel=1e-3) or wrist_mm == pytest.approx(50.0, rel=1e-3)


def test_pictures_of_lenses_and_of_other_sizes_are_refused(predictor: HandPredictor, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"has 96×96 px, the image 50×96"):
        predictor.predict(picture(hands(0))[:, :50], CAMERA, BOX, "right")
    with pytest.raises(ValueError, match="crop its rectified camera"):
        predictor.predict(picture(hands(0)), replace(CAMERA, lens=OVFishEye62()), BOX, "right")
