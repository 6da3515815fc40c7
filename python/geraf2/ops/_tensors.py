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


def has_kernels(*values: Any) -> bool:
    """Whether the kernels run where these are; arrays are on the CPU, where they do."""
    return all(v.device.type == "cpu" for v in values if isinstance(v, torch.Tensor))


def to_numpy(tensor: torch.Tensor) -> Array:
    """Memory of a tensor as an array, a copy if it is not on the CPU; views are resolved first."""
    array: Array = tensor.detach().resolve_conj().resolve_neg().cpu().numpy()
    return array
