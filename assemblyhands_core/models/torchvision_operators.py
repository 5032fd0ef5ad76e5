"""Make torchvision importable beside a torch that its compiled operators do not fit.

The registry's torchvision is built for CUDA. Beside a CPU-only torch its library does not load, and its import fails
with "operator torchvision::nms does not exist", taking timm and lightning (by torchmetrics) down with it, although
nothing here calls those operators. Importing this module defines the two that torchvision asks for by name, without a
body, only where its own cannot be had. Import it before timm and before lightning.
"""

import torch

_SIGNATURE = "(Tensor dets, Tensor scores, float iou_threshold) -> Tensor"


def _define_missing_operators() -> None:
    try:
        import torchvision  # noqa: F401
    except RuntimeError as error:
        if "torchvision::nms" not in str(error):
            raise
        for name in ("nms", "qnms"):
            torch.library.define(f"torchvision::{name}", _SIGNATURE)


_define_missing_operators()
