"""Figures and the HTML report."""

from geraf2.report.depth import sharpest_slice
from geraf2.report.figures import error_curves, glint_overview, mesh_views, projections, sdf_slices
from geraf2.report.render import MeshPainter, View
from geraf2.report.run_report import RunArtefacts, read_run, run_view, write_report

__all__ = [
    "MeshPainter",
    "RunArtefacts",
    "View",
    "error_curves",
    "glint_overview",
    "mesh_views",
    "projections",
    "read_run",
    "run_view",
    "sdf_slices",
    "sharpest_slice",
    "write_report",
]
