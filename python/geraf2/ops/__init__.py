"""Kernels as functions of arrays and tensors; the only room that touches the native module."""

from geraf2.ops.matched_filter import matched_filter
from geraf2.ops.simd import simd_level

__all__ = ["matched_filter", "simd_level"]
