"""`geraf2 reconstruct --preset matched-filter | normal-field | back-projection`."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from geraf2.baselines import (
    BaselineConfig,
    back_projection_cloud,
    cloud_as_mesh,
    normal_field_surface,
)
from geraf2.io.mesh import TriangleMesh
from geraf2.scene import Capture, LosPrior

if TYPE_CHECKING:
    from geraf2.surfaces.extraction import ExtractedMeshes

Baseline = Literal["matched-filter", "normal-field", "back-projection"]
BASELINES: tuple[Baseline, ...] = get_args(Baseline)


def settings_of(preset: Baseline, config: BaselineConfig) -> Any:
    """Constants of one baseline."""
    return getattr(config, preset.replace("-", "_"))


def open_meshes(
    preset: Baseline,
    capture: Capture,
    prior: LosPrior,
    config: BaselineConfig,
    num_threads: int | None,
    report: Callable[[float], None],
) -> "ExtractedMeshes":
    """Meshes of a baseline whose surface is open: a cloud, or what of an isosurface has echoes."""
    from geraf2.surfaces.extraction import (  # noqa: PLC0415 - scikit-image takes 0.3 s
        ExtractedMeshes,
        box_surface,
        join_meshes,
    )

    if preset == "back-projection":
        cloud = back_projection_cloud(
            capture, prior, config.back_projection, num_threads=num_threads, progress=report
        )
        mesh = cloud_as_mesh(cloud, config.back_projection.spacing_m)
        confidence = np.repeat(cloud.strengths / cloud.strengths.max(), 3)
    else:
        mesh = normal_field_surface(
            capture, prior, config.normal_field, num_threads=num_threads, progress=report
        )
        confidence = np.ones(mesh.vertices.shape[0])
    content = TriangleMesh(vertices=mesh.vertices, faces=mesh.faces, confidence=confidence)
    box = box_surface(prior)
    return ExtractedMeshes(mesh=join_meshes(box, content), mesh_box=box, mesh_content=content)
