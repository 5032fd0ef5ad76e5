"""Egocentric crops to joints with a frozen SVEgoNet, batch by batch."""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import cv2
import numpy as np
import torch
from jaxtyping import Float32, UInt8

from assemblyhands_core.data.ego_boxes import IDENTITIES
from assemblyhands_core.data.hand_crops import window_map
from assemblyhands_core.hands.joints import HANDS, NUM_JOINTS, Hand
from assemblyhands_core.models.svegonet import Decoding, SVEgoNet

Picture = UInt8[np.ndarray, "_ _ 3"]  # among others of other sizes


@dataclass(frozen=True, eq=False)
class EgoPredictions:
    """What the network says about the hand of each crop.

    Attributes:
        pixels: Joints (x, y) in the crop's own pixels.
        depth_mm: Beyond the wrist, along the optical axis.
        confidence: Of each joint, in [0, 1].
        identity: Probabilities of `svegonet.IDENTITIES`.
    """

    pixels: Float32[np.ndarray, "crop joint=21 2"]
    depth_mm: Float32[np.ndarray, "crop joint=21"]
    confidence: Float32[np.ndarray, "crop joint=21"]
    identity: Float32[np.ndarray, "crop identity=3"]


def predict_hands(
    network: SVEgoNet,
    pictures: Sequence[Picture],
    hands: Sequence[Hand],
    *,
    batch_size: int,
    num_threads: int,
    decoding: Decoding = "soft_argmax",
) -> EgoPredictions:
    """Run the network on crops; on a CPU batches run side by side, each on one thread, so that results do not vary.

    Args:
        network: For evaluation, as `pretrained.load_svegonet` gives it.
        pictures: Square crops.
        hands: Which hand each is of: its joints are given.
        batch_size: Crops at a time.
        num_threads: Of the CPU.
        decoding: How heatmaps are read.
    """
    torch.set_num_threads(1)
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    network = network.to(device)
    count, size = len(pictures), network.config.image_size_px
    found = EgoPredictions(
        pixels=np.empty((count, NUM_JOINTS, 2), dtype=np.float32),
        depth_mm=np.empty((count, NUM_JOINTS), dtype=np.float32),
        confidence=np.empty((count, NUM_JOINTS), dtype=np.float32),
        identity=np.empty((count, len(IDENTITIES)), dtype=np.float32),
    )

    def predict(part: slice) -> None:
        maps = [_to_network(picture, size) for picture in pictures[part]]
        images = np.stack([cv2.warpAffine(p, A[:2], (size, size)) for p, A in zip(pictures[part], maps, strict=True)])
        with torch.inference_mode():
            batch = torch.from_numpy(images).to(device).movedim(-1, 1).float() / 255.0
            estimate = network(batch, decoding)
        own = [np.arange(NUM_JOINTS) + NUM_JOINTS * HANDS.index(hand) for hand in hands[part]]
        rows = np.arange(len(own))[:, None], np.stack(own)
        A = np.stack(maps).astype(np.float32)
        found.pixels[part] = (estimate.pixels.cpu().numpy()[rows] - A[:, None, :2, 2]) / A[:, None, :1, 0]
        found.depth_mm[part] = estimate.depth_mm.cpu().numpy()[rows]
        found.confidence[part] = estimate.confidence.cpu().numpy()[rows]
        found.identity[part] = estimate.identity.softmax(dim=-1).cpu().numpy()

    with ThreadPoolExecutor(1 if device.type == "cuda" else num_threads) as threads:
        list(threads.map(predict, [slice(first, first + batch_size) for first in range(0, count, batch_size)]))
    return found


def _to_network(picture: Picture, size_px: int) -> np.ndarray:
    """Return the map from a crop's pixels to those that the network sees."""
    height, width = picture.shape[:2]
    return window_map(np.array([width - 1, height - 1]) / 2, max(width, height), size_px)
