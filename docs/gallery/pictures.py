"""Shared code of the gallery: a small scene, and pictures of meshes side by side."""

import numpy as np
from matplotlib import pyplot as plt

from geraf2 import SceneSpec, Wall
from geraf2.io.mesh import TriangleMesh
from geraf2.report import MeshPainter, View
from geraf2.simulation import DisturbanceSpec, FigureSpec, NumericsSpec, ScanSpec, WorldSpec

BOX_M = (0.2, 0.2, 0.2)
"""Outer side lengths of the carton of most scenes [m]."""
GREY, STEEL = (0.82, 0.82, 0.80), (0.55, 0.68, 0.85)


def scene(
    figure: FigureSpec,
    *,
    scan: ScanSpec | None = None,
    walls: tuple[Wall, ...] = (Wall(size_m=BOX_M, thickness_m=0.004, permittivity=1.6),),
    disturbance: DisturbanceSpec | None = None,
    world: WorldSpec | None = None,
) -> SceneSpec:
    """Return a scene that takes half a minute: twelve planes, antennas 4 mm apart."""
    return SceneSpec(
        figure=figure,
        walls=walls,
        scan=scan or level_scan(12),
        disturbance=disturbance or DisturbanceSpec(),
        world=world or WorldSpec(),
        numerics=NumericsSpec(wall_patch_m=0.02, antenna_block_m=0.07),
    )


def level_scan(n_planes: int, **more: object) -> ScanSpec:
    """Planes of 14 by 20 cm around the box, at its height."""
    return ScanSpec(n_poses=n_planes, spacing_m=0.004, aperture_m=(0.14, 0.2), **more)


def side_by_side(meshes: dict[str, TriangleMesh], azimuth_deg: float = 30.0) -> None:
    """Draw meshes at one scale, the last one (the truth) in grey."""
    corners = np.concatenate([mesh.vertices for mesh in meshes.values()])
    middle = (corners.min(axis=0) + corners.max(axis=0)) / 2
    view = View(
        azimuth_deg=azimuth_deg,
        center_m=tuple(middle),
        half_width_m=1.05 * float(np.linalg.norm(corners - middle, axis=1).max()),
    )
    figure, panels = plt.subplots(1, len(meshes), figsize=(3.1 * len(meshes), 3.3))
    last = len(meshes) - 1
    for number, (panel, (title, mesh)) in enumerate(
        zip(np.ravel(panels), meshes.items(), strict=True)
    ):
        colour = GREY if number == last else STEEL
        panel.imshow(MeshPainter(mesh).render(view, np.tile(colour, (len(mesh.vertices), 1))))
        panel.set_title(title, fontsize=10)
        panel.axis("off")
    figure.tight_layout()
