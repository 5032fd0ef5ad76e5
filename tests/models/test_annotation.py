"""What the network is given, batch by batch, and that all of it comes back in order."""

from typing import Any

import numpy as np
import pytest
import torch

from assemblyhands_core.data.crop_images import encode_jpeg
from assemblyhands_core.data.hand_crops import StoredView
from assemblyhands_core.data.rounds import Box, HandWindows
from assemblyhands_core.models.annotation import estimate_hands
from assemblyhands_core.models.mvexonet import HandEstimate, MVExoNet, MVExoNetConfig

TINY = MVExoNetConfig("mobilenetv3_small_050", 3, 8, image_size_px=32, num_voxels=8, v2v="slim")
P = np.hstack([np.diag([100.0, 100.0, 1.0]), [[0.0], [0.0], [500.0]]])


class Recorder(MVExoNet):
    """A network that puts all joints into the root, and keeps what it was given."""

    def __init__(self) -> None:
        torch.nn.Module.__init__(self)
        self.config, self.batches = TINY, list[Any]()

    def forward(self, *arguments: Any) -> Any:
        self.batches.append(arguments)
        joints = arguments[3][:, None].expand(-1, 21, -1)
        return HandEstimate(joints, joints[..., 0] / 100, joints, torch.zeros(len(joints), 21, 2, 2, 2))


def _hand(number: int, num_views: int) -> HandWindows:
    views = tuple(
        StoredView(f"{v}", encode_jpeg(np.full((40, 40, 3), 50 + 50 * v, np.uint8), 100), P, (40, 40))
        for v in range(num_views)
    )
    box = Box(np.array([19.5, 19.5]), 20.0)
    return HandWindows(np.array([number, 0.0, 0.0]), number % 2 == 1, views, (box,) * num_views, False, "joints")


@pytest.mark.parametrize(("batch_size", "num_threads", "sizes"), [(2, 1, [2, 2, 1]), (1, 3, [1] * 5), (8, 2, [5])])
def test_hands_come_back_in_order(batch_size: int, num_threads: int, sizes: list[int]) -> None:
    network, threads = Recorder(), torch.get_num_threads()
    found = estimate_hands(network, [_hand(number, 2) for number in range(5)], batch_size, num_threads)
    torch.set_num_threads(threads)
    assert [len(batch[0]) for batch in network.batches] == sizes
    assert found.joints_world_mm[:, 7, 0].tolist() == [0.0, 1.0, 2.0, 3.0, 4.0]
    np.testing.assert_allclose(found.confidence[:, 3], np.arange(5) / 100, rtol=1e-6)
    told = [pair for batch in network.batches for pair in zip(batch[3][:, 0].tolist(), batch[4].tolist(), strict=True)]
    assert sorted(told) == [(0.0, False), (1.0, True), (2.0, False), (3.0, True), (4.0, False)]


def test_pictures_are_in_0_to_1_and_views_that_a_hand_lacks_are_black() -> None:
    network = Recorder()
    estimate_hands(network, [_hand(0, 1), _hand(1, 3)], 2, 1)
    ((images, matrices, is_used, _, _),) = network.batches
    assert images.shape == (2, 3, 3, 32, 32) and is_used.tolist() == [[True, False, False], [True] * 3]
    expected = np.array([[50, 0, 0], [50, 100, 150]]) / 255
    np.testing.assert_allclose(images.mean(dim=(2, 3, 4)), expected, atol=1e-3)
    assert not matrices[0, 1:].any()
    # 20 px become 32 px: pixel 19.5 of the crop is pixel 15.5 of the picture.
    pixel = matrices[1, 0].numpy() @ np.array([97.5, 97.5, 0.0, 1.0]) / 500
    np.testing.assert_allclose(pixel, [15.5, 15.5, 1.0])


def test_no_hands() -> None:
    assert estimate_hands(Recorder(), [], 4, 1).joints_world_mm.shape == (0, 21, 3)


def test_the_numbers_do_not_depend_on_how_many_threads_there_are() -> None:
    torch.manual_seed(0)
    config = MVExoNetConfig("mobilenetv3_small_050", 3, 8, image_size_px=32, num_voxels=8, v2v="slim")
    network, threads = MVExoNet(config).eval(), torch.get_num_threads()
    hands = [_hand(number, 3) for number in range(7)]
    one, several = (estimate_hands(network, hands, 2, num_threads) for num_threads in (1, 3))
    torch.set_num_threads(threads)
    assert np.ptp(one.joints_world_mm, axis=0).max() > 0.1
    np.testing.assert_array_equal(one.joints_world_mm, several.joints_world_mm)
    np.testing.assert_array_equal(one.confidence, several.confidence)
