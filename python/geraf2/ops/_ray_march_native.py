"""Checks of the ray march's samples, whether they came as arrays or as tensors."""

import numpy as np

from geraf2._types import Array
from geraf2._validation import require_positive, require_shape


def require_samples(sdf: Array, cos: Array, step: Array, inv_s: float) -> None:
    """Raise unless the arrays agree in type and shape and inv_s is positive."""
    if sdf.dtype not in (np.float32, np.float64):
        msg = f"sdf must be float32 or float64, got {sdf.dtype}"
        raise TypeError(msg)
    require_shape("sdf", sdf, (None, None))
    for name, array in (("cos", cos), ("step", step)):
        if array.dtype != sdf.dtype:
            msg = f"{name} must be {sdf.dtype} as sdf is, got {array.dtype}"
            raise TypeError(msg)
        require_shape(name, array, sdf.shape)
    require_positive("inv_s", float(inv_s))
    if float(inv_s) > np.finfo(sdf.dtype).max:
        msg = f"inv_s must be finite as {sdf.dtype}, got {float(inv_s)!r}"
        raise ValueError(msg)
