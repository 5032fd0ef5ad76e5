"""Networks in tests are tiny: one thread each, so that busy cores do not wait for one another."""

import pytest
import torch

from assemblyhands_core.models import torchvision_operators  # noqa: F401  (before tests import timm)


@pytest.fixture(autouse=True, scope="session")
def one_thread() -> None:
    torch.set_num_threads(1)
