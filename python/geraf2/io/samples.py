"""Samples of a receiver as complex numbers, or as the integers that its converter gave.

A converter gives I and Q of 16 bits. A scene may keep them so: half the bytes of complex64,
without loss. -32768 marks a missing sample, as NaN does among complex numbers: from a
converter that saturates at -32768 a scene takes -32767.
"""

import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geraf2._types import Complexes, Words
from geraf2.records import Pose, RawPose, Samples

NO_SAMPLE = np.int16(-0x8000)


def complex_samples(samples: Samples) -> Complexes:
    """Complex numbers, (...,) of int16 (..., 2), NO_SAMPLE too; complex ones stay as they are."""
    if np.iscomplexobj(samples):
        return np.asarray(samples, dtype=np.complex64)
    signal = np.empty(samples.shape[:-1], dtype=np.complex64)
    signal.view(np.float32).reshape(samples.shape)[...] = samples
    return signal


def complex_pose(pose: RawPose) -> Pose:
    """Pose whose samples are complex; shares the arrays, but for samples that were integers."""
    return Pose(**{**vars(pose), "signal": complex_samples(pose.signal)})


def conjugate_samples(samples: Samples) -> Samples:
    """Conjugate samples, integers in place; -32768 becomes -32767 first."""
    if np.iscomplexobj(samples):
        return np.asarray(np.conj(samples))
    turned = stored_integers(samples)
    np.negative(turned[..., 1], out=turned[..., 1])
    return turned


def stored_integers(samples: Samples) -> Words:
    """Integers of which none is NO_SAMPLE; a copy only where one was."""
    if samples.dtype != np.int16:
        msg = f"samples must be int16, got {samples.dtype}"
        raise TypeError(msg)
    # Four times as fast as a clip, and next to no capture has one.
    if not samples.size or samples.min() > NO_SAMPLE:
        return np.asarray(samples)
    return np.maximum(samples, np.int16(NO_SAMPLE + 1))


def crc_of(array: NDArray[Any], before: int = 0) -> int:
    """CRC-32 of the bytes of an array that follows those before."""
    return zlib.crc32(np.ascontiguousarray(array).data, before) if array.size else before
