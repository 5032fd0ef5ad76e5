"""Weights of the reference programs, which their numbers name by a rule instead of holding them."""

from collections.abc import Mapping

import numpy as np
import torch
from torch import Tensor

Arrays = Mapping[str, np.ndarray]


def reference_weights(golden: Arrays, prefix: str = "") -> dict[str, Tensor]:
    """Return the weights under the reference's names, checked by the first element of each.

    Args:
        golden: Has `weight_seed`, `names`, `shapes`, `ndim` and `first_value`.
        prefix: What stands before these.
    """
    names, shapes, ndim, seed, first = (
        golden[prefix + key] for key in ("names", "shapes", "ndim", "weight_seed", "first_value")
    )
    weights = {}
    for k, name in enumerate(names.tolist()):
        shape = tuple(shapes[k, : ndim[k]].tolist())
        values = np.asarray(_values(name, shape, np.random.RandomState(int(seed) + k)))
        np.testing.assert_allclose(values.flat[0], first[k], rtol=1e-6)
        weights[name] = torch.as_tensor(values.astype(np.float32))
    return weights


def _values(name: str, shape: tuple[int, ...], state: np.random.RandomState) -> np.ndarray:
    if name.endswith("num_batches_tracked"):
        return np.zeros(shape)
    if name.endswith("A_res"):
        return 0.01 * state.randn(*shape)
    if name.endswith(("running_mean", "bias")):
        return 0.1 * state.randn(*shape)
    if name.endswith("running_var"):
        return state.uniform(0.5, 1.5, shape)
    return 1 + 0.1 * state.randn(*shape) if len(shape) == 1 else state.randn(*shape) * np.sqrt(2 / np.prod(shape[1:]))
