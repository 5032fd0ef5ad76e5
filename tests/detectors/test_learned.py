"""Our own detectors find what their network finds, in the picture's own pixels, whatever the size of the picture."""

from pathlib import Path

import numpy as np
import pytest
import torch

from assemblyhands_core.detectors.base import DetectorError, HandCrop
from assemblyhands_core.detectors.learned import LearnedBody, LearnedHands, fingerprint
from assemblyhands_core.models.hand_keypoints import HandKeypointConfig, HandKeypointNet
from assemblyhands_core.models.pretrained import save_weights


class Brightest(torch.nn.Module):
    """A network that finds every keypoint at the brightest pixel and is sure of it."""

    def __init__(self, network: HandKeypointNet) -> None:
        super().__init__()
        self.config = network.config
        self.num_asked = 0

    def forward(self, images: torch.Tensor, is_left: torch.Tensor) -> object:
        from assemblyhands_core.models.hand_keypoints import KeypointEstimate

        self.num_asked += 1
        grey = images.mean(dim=1)
        weights = (grey > 0.9 * grey.max()).double()
        rows, columns = torch.meshgrid(*(torch.arange(n) for n in grey.shape[1:]), indexing="ij")
        at = torch.stack([(weights * columns).sum(), (weights * rows).sum()]) / weights.sum()
        spread = torch.stack([torch.linspace(-6, 6, self.config.num_joints)] * 2, dim=-1)
        pixels = (at + spread)[None].float()
        sure = torch.full(pixels.shape[:2], 0.9)
        return KeypointEstimate(pixels, sure, pixels / 4, torch.zeros(1, 1, 1, 1))


def weights(folder: Path, num_joints: int, size_px: int) -> Path:
    config = HandKeypointConfig(num_levels=2, num_channels=8, image_size_px=size_px, num_joints=num_joints)
    save_weights(folder / "net.safetensors", HandKeypointNet(config), {})
    return folder / "net.safetensors"


def spot(width: int, height: int, x: int, y: int, radius: int) -> np.ndarray:
    rows, columns = np.mgrid[:height, :width]
    is_bright = (rows - y) ** 2 + (columns - x) ** 2 <= radius**2
    return np.where(is_bright[..., None], 250, 20).astype(np.uint8).repeat(3, axis=-1)


@pytest.mark.parametrize(("width", "height"), [(192, 192), (300, 300)])
def test_a_hand_is_found_in_the_crops_own_pixels(tmp_path: Path, width: int, height: int) -> None:
    detector = LearnedHands(weights(tmp_path, 21, 64))
    network = Brightest(detector._network)
    detector._network = network  # type: ignore[assignment]
    found = detector.detect(spot(width, height, width // 2 - 9, height // 2 + 13, 8), "left", "c", 0)
    assert found is not None and network.num_asked == 2, "asked again for the box around what was found"
    center = found.keypoints_px.mean(axis=0)
    assert center == pytest.approx([width // 2 - 9, height // 2 + 13], abs=0.6)
    assert found.confidence == pytest.approx(np.full(21, 0.9))


def test_a_body_is_found_in_the_pictures_own_pixels(tmp_path: Path) -> None:
    detector = LearnedBody(weights(tmp_path, 17, 96))
    detector._network = Brightest(detector._network)  # type: ignore[assignment]
    found = detector.detect(spot(384, 216, 250, 80, 14), "c", 0)
    assert found.keypoints_px.shape == (1, 17, 2)
    assert found.keypoints_px[0].mean(axis=0) == pytest.approx([250, 80], abs=1.5)


def test_what_is_not_sure_is_missing(tmp_path: Path) -> None:
    hands = LearnedHands(weights(tmp_path, 21, 64), min_confidence=1.1)
    assert hands.detect(spot(64, 64, 30, 30, 5), "right", "c", 0) is None
    body = LearnedBody(weights(tmp_path, 17, 96), min_confidence=1.1)
    assert len(body.detect(spot(96, 54, 30, 30, 5), "c", 0).confidence) == 0


def test_a_network_for_something_else_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DetectorError, match=r"net\.safetensors finds 17 joints, 21 are wanted"):
        LearnedHands(weights(tmp_path, 17, 96))
    with pytest.raises(DetectorError, match=r"net\.safetensors finds 21 joints, 17 are wanted"):
        LearnedBody(weights(tmp_path, 21, 64))


def test_weights_count_and_have_to_be_there(tmp_path: Path) -> None:
    file = weights(tmp_path, 21, 64)
    assert set(fingerprint({"weights": str(file)})) == {"net.safetensors"}
    with pytest.raises(DetectorError, match=r"nowhere\.safetensors, which does not exist: `make train`"):
        LearnedHands(tmp_path / "nowhere.safetensors")


def test_many_crops_at_once_give_what_each_gives_alone(tmp_path: Path) -> None:
    torch.manual_seed(0)
    detector = LearnedHands(weights(tmp_path, 21, 64), min_confidence=0.0)
    crops = [HandCrop(spot(96 + 8 * i, 96, 30 + i, 50, 9), "left" if i % 3 else "right", "c", i) for i in range(19)]
    alone = [detector.detect(crop.image_rgb, crop.hand, crop.camera_id, crop.frame) for crop in crops]
    for one, other in zip(detector.detect_many(crops), alone, strict=True):
        assert one is not None and other is not None
        np.testing.assert_allclose(one.keypoints_px, other.keypoints_px, atol=1e-2)
        np.testing.assert_allclose(one.confidence, other.confidence, atol=1e-4)
    assert detector.detect_many([]) == []
