"""SVEgoNet as an ONNX file, for programs without torch (extra `onnx`).

    python -m assemblyhands_core.models.onnx_export weights/svegonet.safetensors svegonet.onnx

Input `images` (batch, 3, size, size), float32 in [0, 1]. Outputs: `pixels` (batch, 42, 2), `depth_mm` (batch, 42) and
`confidence` (batch, 42), right hand first, and `identity` (batch, 3), probabilities of right, left, both.
"""

import argparse
import importlib.util
from pathlib import Path
from typing import Final

import torch
from jaxtyping import Float
from torch import Tensor, nn

from assemblyhands_core.models.pretrained import load_svegonet
from assemblyhands_core.models.svegonet import SVEgoNet

OUTPUTS: Final = ("pixels", "depth_mm", "confidence", "identity")
_OPSET: Final = 17


class _Outputs(nn.Module):
    """What users of the file get."""

    def __init__(self, network: SVEgoNet) -> None:
        super().__init__()
        self.network = network

    def forward(self, images: Float[Tensor, "batch 3 height width"]) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        found = self.network(images)
        return found.pixels, found.depth_mm, found.confidence, found.identity.softmax(dim=-1)


def export_onnx(network: SVEgoNet, path: Path) -> None:
    """Write a network, which must be for evaluation, to a file; batches may have any size.

    Raises:
        ValueError: The package onnx is not installed.
    """
    if importlib.util.find_spec("onnx") is None:
        raise ValueError("Package onnx is not installed: pip install -c constraints.txt -e '.[onnx]'.")
    size = network.config.image_size_px
    torch.onnx.export(
        _Outputs(network).eval(),
        (torch.zeros(1, 3, size, size),),
        str(path),
        input_names=["images"],
        output_names=list(OUTPUTS),
        dynamic_axes={name: {0: "batch"} for name in ("images", *OUTPUTS)},
        opset_version=_OPSET,
        dynamo=False,
    )


def main() -> None:
    """Export the file that the command line names."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("weights", type=Path)
    parser.add_argument("onnx", type=Path)
    options = parser.parse_args()
    export_onnx(load_svegonet(options.weights), options.onnx)


if __name__ == "__main__":
    main()
