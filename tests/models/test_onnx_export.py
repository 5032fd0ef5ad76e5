"""The ONNX file gives what the network gives, for batches of any size."""

from pathlib import Path

import numpy as np
import pytest
import torch

from assemblyhands_core.models.onnx_export import OUTPUTS, export_onnx
from assemblyhands_core.models.svegonet import SVEgoNet, SVEgoNetConfig

TINY = SVEgoNetConfig("mobilenetv3_small_050", 2, 8, image_size_px=64, num_depths=8)


@pytest.mark.parametrize("batch", [1, 3])
def test_the_file_gives_the_networks_numbers(tmp_path: Path, batch: int) -> None:
    pytest.importorskip("onnx")
    runtime = pytest.importorskip("onnxruntime")
    torch.manual_seed(0)
    network = SVEgoNet(TINY).eval()
    with torch.no_grad():
        network.head[-1].weight.mul_(100.0)
    path = tmp_path / "net.onnx"
    export_onnx(network, path)
    images = torch.rand(batch, 3, 64, 64)
    with torch.inference_mode():
        expected = network(images)
    found = runtime.InferenceSession(str(path)).run(list(OUTPUTS), {"images": images.numpy()})
    assert [values.shape for values in found] == [(batch, 42, 2), (batch, 42), (batch, 42), (batch, 3)]
    assert np.ptp(found[0]) > 5.0, "joints lie in different places"
    for name, values, atol in zip(OUTPUTS[:3], found[:3], (0.01, 0.05, 1e-4), strict=True):
        np.testing.assert_allclose(values, getattr(expected, name).numpy(), rtol=0, atol=atol)
    np.testing.assert_allclose(found[3], expected.identity.softmax(-1).numpy(), rtol=0, atol=1e-5)
