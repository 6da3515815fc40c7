"""Scores beside a mesh: metrics.json and psnr.json, checked against their records."""

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from geraf2.evaluation import MeshMetrics
from geraf2.io.digests import file_digest
from geraf2.io.toml import from_table
from geraf2.report.run_sections import read_object


@dataclass(frozen=True, kw_only=True)
class _Metrics(MeshMetrics):
    mesh_digest: str


@dataclass(frozen=True, kw_only=True)
class _Psnr:
    psnr_db: dict[float, float]
    mesh_digest: str


def read_metrics(path: Path, mesh: Path | None) -> dict[str, Any]:
    """Content of metrics.json; {} where there is none, or it is of another mesh."""
    return _read(path, mesh, _Metrics)


def read_psnr(path: Path, mesh: Path) -> dict[str, Any]:
    """Content of psnr.json; {} where there is none, or it is of another mesh."""
    return _read(path, mesh, _Psnr)


def _read(path: Path, mesh: Path | None, kind: type[_Metrics | _Psnr]) -> dict[str, Any]:
    if mesh is None:
        return {}
    stored = read_object(path, "the metrics")
    if stored.get("mesh_digest") != file_digest(mesh):
        return {}
    known = {entry.name for entry in fields(kind)}
    from_table({key: value for key, value in stored.items() if key in known}, kind, path)
    return stored
