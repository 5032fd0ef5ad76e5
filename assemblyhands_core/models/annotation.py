"""Hands to joints with a frozen MVExoNet, batch by batch."""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from threading import Lock
from typing import Any, Final

import numpy as np
import torch
from jaxtyping import Float32
from torch import Tensor

from assemblyhands_core.data.rounds import HandWindows
from assemblyhands_core.hands.joints import NUM_JOINTS
from assemblyhands_core.models.mvexonet import HandEstimate, MVExoNet

_EXACT: Final = {"benchmark": False, "deterministic": True, "allow_tf32": False}  # the same numbers on every run


@dataclass(frozen=True, eq=False)
class Estimates:
    """What the network says about hands.

    Attributes:
        joints_world_mm: Their joints.
        confidence: Of each joint, in [0, 1].
    """

    joints_world_mm: Float32[np.ndarray, "hand joint=21 3"]
    confidence: Float32[np.ndarray, "hand joint=21"]


def estimate_hands(network: MVExoNet, hands: Sequence[HandWindows], batch_size: int, num_threads: int) -> Estimates:
    """Run the network on hands of any side and instant, on a GPU if there is one.

    On a CPU batches run side by side, each on one thread: the numbers are the same to the last bit, however many
    threads there are. Which hands share a batch does not matter beyond the last bits.

    Args:
        network: For evaluation, as `pretrained.load_mvexonet` gives it.
        hands: Each with a known root and at least one view.
        batch_size: Hands at a time.
        num_threads: Of the CPU.
    """
    torch.set_num_threads(1)
    is_gpu = torch.cuda.is_available()
    device = torch.device("cuda" if is_gpu else "cpu")
    network = network.to(device)
    gate: AbstractContextManager[Any] = Lock() if is_gpu else nullcontext()  # one batch at a time in the GPU's memory

    joints = np.empty((len(hands), NUM_JOINTS, 3), dtype=np.float32)
    confidence = np.empty((len(hands), NUM_JOINTS), dtype=np.float32)

    def estimate(part: slice) -> None:
        arguments = _tensors(hands[part], network.config.image_size_px)
        with gate:
            found = _forward(network, [tensor.to(device) for tensor in arguments])
            joints[part], confidence[part] = found.joints_world_mm.cpu().numpy(), found.confidence.cpu().numpy()

    with ThreadPoolExecutor(num_threads) as threads:
        list(threads.map(estimate, [slice(first, first + batch_size) for first in range(0, len(hands), batch_size)]))
    return Estimates(joints, confidence)


def _tensors(hands: Sequence[HandWindows], size_px: int) -> list[Tensor]:
    """Return the network's arguments; views that a hand lacks are black and not used."""
    num_views = max(len(hand.views) for hand in hands)
    images = np.zeros((len(hands), num_views, size_px, size_px, 3), dtype=np.uint8)
    matrices = np.zeros((len(hands), num_views, 3, 4))
    is_used = np.zeros((len(hands), num_views), dtype=bool)
    for row, hand in enumerate(hands):
        for slot, piece in enumerate(hand.cuts(size_px)):
            images[row, slot], matrices[row, slot], is_used[row, slot] = piece.image, piece.P_pixel_from_world, True
    roots = np.stack([hand.root_world_mm for hand in hands]).astype(np.float32)
    sides = np.array([hand.is_left for hand in hands])
    arrays = (images, matrices.astype(np.float32), is_used, roots, sides)
    return [torch.from_numpy(array) for array in arrays]


def _forward(network: MVExoNet, arguments: Sequence[Tensor]) -> HandEstimate:
    images, *others = arguments
    with torch.inference_mode(), torch.backends.cudnn.flags(enabled=True, **_EXACT):
        found: HandEstimate = network(images.movedim(-1, -3).float() / 255.0, *others)
    return found
