"""Between torch tensors and the arrays that the kernels read."""

from typing import Any

import numpy as np
import torch

from geraf2._types import Array


def to_tensor(name: str, values: Any) -> torch.Tensor:
    """Return a tensor on the CPU; arrays become tensors without a gradient."""
    tensor = values if isinstance(values, torch.Tensor) else torch.from_numpy(np.asarray(values))
    if tensor.device.type != "cpu":
        msg = f"{name} must be on the CPU, got device {tensor.device}"
        raise ValueError(msg)
    return tensor


def to_numpy(tensor: torch.Tensor) -> Array:
    """Memory of a tensor as an array; a conjugate or negative view is resolved first."""
    array: Array = tensor.detach().resolve_conj().resolve_neg().numpy()
    return array
