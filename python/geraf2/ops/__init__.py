"""Kernels as functions of arrays and tensors; the only room that touches the native module."""

from geraf2.ops.matched_filter import matched_filter
from geraf2.ops.simd import embree_major, max_threads, simd_level

__all__ = ["embree_major", "matched_filter", "max_threads", "simd_level"]
