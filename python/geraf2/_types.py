"""Types that many signatures name."""

import os
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]
Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]
Bytes = NDArray[np.uint8]
Words = NDArray[np.int16]
Floats32 = NDArray[np.float32]
Complexes = NDArray[np.complex64]

AnyPath = str | os.PathLike[str]

Progress = Callable[[float], None]
"""Called with the fraction done."""
