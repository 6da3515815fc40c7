"""Isosurfaces and metrics, each with its definition."""

from geraf2.evaluation.confidence import (
    ConfidenceConfig,
    SurfaceEvidence,
    surface_evidence,
    with_confidence,
)
from geraf2.evaluation.extraction import (
    ExtractedMeshes,
    box_surface,
    content_surface,
    cropped_content,
    extract_cropped_meshes,
    extract_meshes,
    join_meshes,
)
from geraf2.evaluation.isosurface import (
    ComponentReport,
    SurfaceReport,
    extract_surface,
    largest_components,
    redistance,
    surface_report,
)
from geraf2.evaluation.mesh_metrics import (
    MeshMetrics,
    describe,
    evaluate_mesh,
    sample_surface,
    write_metrics,
)
from geraf2.evaluation.oracle import OracleScore, oracle_matched_filter

__all__ = [
    "ComponentReport",
    "ConfidenceConfig",
    "ExtractedMeshes",
    "MeshMetrics",
    "OracleScore",
    "SurfaceEvidence",
    "SurfaceReport",
    "box_surface",
    "content_surface",
    "cropped_content",
    "describe",
    "evaluate_mesh",
    "extract_cropped_meshes",
    "extract_meshes",
    "extract_surface",
    "join_meshes",
    "largest_components",
    "oracle_matched_filter",
    "redistance",
    "sample_surface",
    "surface_evidence",
    "surface_report",
    "with_confidence",
    "write_metrics",
]
