"""Kernels as functions of arrays and tensors; the only package that touches the native module."""

from geraf2.ops._forms import EchoForm, SamplePairs
from geraf2.ops.matched_filter import (
    MatchedFilterPlan,
    MethodChoice,
    explain_method,
    matched_filter,
)
from geraf2.ops.ray_march import RayMarch, ray_march
from geraf2.ops.sdf_grid import GridSample, sdf_grid
from geraf2.ops.signal_tracer import signal_tracer
from geraf2.ops.simd import embree_major, kernel_paths, max_threads, simd_level

__all__ = [
    "EchoForm",
    "GridSample",
    "MatchedFilterPlan",
    "MethodChoice",
    "RayMarch",
    "SamplePairs",
    "embree_major",
    "explain_method",
    "kernel_paths",
    "matched_filter",
    "max_threads",
    "ray_march",
    "sdf_grid",
    "signal_tracer",
    "simd_level",
]
