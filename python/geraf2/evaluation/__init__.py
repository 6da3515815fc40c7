"""Metrics against a true surface, each with its definition."""

from geraf2.evaluation.mesh_metrics import (
    MeshMetrics,
    SizeErrors,
    evaluate_mesh,
    sample_surface,
    write_metrics,
)
from geraf2.evaluation.oracle import OracleScore, oracle_matched_filter

__all__ = [
    "MeshMetrics",
    "OracleScore",
    "SizeErrors",
    "evaluate_mesh",
    "oracle_matched_filter",
    "sample_surface",
    "write_metrics",
]
