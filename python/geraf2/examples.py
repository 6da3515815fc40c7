"""A small simulated scan, for first steps and for the examples of this package.

An object of 6 cm in a carton of 16 cm, six planes of antennas 6 mm apart: seconds on one core, and
coarse. Not a measure of quality. Lengths are in metres; no file is needed.

Examples
--------
>>> import geraf2
>>> capture, truth = geraf2.examples.small_capture()
>>> len(capture.poses), capture.poses[0].signal.shape
(6, (441, 32))
"""

from functools import cache

from geraf2.io.mesh import TriangleMesh
from geraf2.pipeline.commands.reconstruct import reconstruct
from geraf2.pipeline.reconstruction import Reconstruction
from geraf2.scene import Capture, Wall
from geraf2.simulation import FigureSpec, NumericsSpec, ScanSpec, SceneSpec, simulate

BOX_M = (0.16, 0.16, 0.16)
"""Outer side lengths of the carton, axes along the frame's [m]."""


def small_scene() -> SceneSpec:
    """Return what is simulated; lengths in metres."""
    return SceneSpec(
        figure=FigureSpec(name="llama", height_m=0.06),
        walls=(Wall(size_m=BOX_M, thickness_m=0.004, permittivity=1.6),),
        scan=ScanSpec(n_poses=6, spacing_m=0.006, aperture_m=(0.12, 0.12)),
        numerics=NumericsSpec(wall_patch_m=0.02, antenna_block_m=0.07),
    )


@cache
def small_capture() -> tuple[Capture, TriangleMesh]:
    """Its capture and the true object [m], simulated once in a process."""
    return simulate(small_scene(), seed=0)


@cache
def small_run() -> Reconstruction:
    """Reconstruction of it by the preset fast, once in a process; its folder goes with it."""
    return reconstruct(small_capture()[0], BOX_M, "fast")
