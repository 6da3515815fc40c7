"""Level of a surface by how squarely the planes see it.

    python bench/python/level_by_angle.py SCENE MESH.ply ... [--truth TRUTH.ply]

A smooth surface echoes where its normal points to the antennas. For each sample of a mesh this
takes the nearest true point, and the smallest angle there between the true normal and the way to
any antenna; whether something stands between is not looked at. It prints, by that angle, the share
of the mesh, its median signed distance to the truth [mm], positive outside, and the share within
5 mm. What no plane sees squarely is not measured: its level says what a method makes of that.
"""

import argparse
from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from geraf2._types import Floats
from geraf2.evaluation.mesh_metrics import sample_surface
from geraf2.geometry.triangles import unit_normals
from geraf2.io.container import TRUTH_NAME
from geraf2.io.mesh import read_mesh
from geraf2.ops.visibility import MeshScene
from geraf2.scene import Capture, load_capture

BOUNDS_DEG = (0.0, 3.0, 8.0, 15.0, 25.0, 40.0, 180.0)
N_SAMPLES = 20000
N_ANTENNAS = 150
"""Of a plane, evenly spread: 1 cm apart on one of 14 x 14 cm."""


def angles_to_antennas(points: Floats, normals: Floats, capture: Capture) -> Floats:
    """Smallest angle between each normal and a way to an antenna, (n,) [degrees]."""
    nearest = np.full(len(points), -1.0)
    for pose in capture.poses:
        for antenna in pose.phase_centers[:: max(pose.n_antennas // N_ANTENNAS, 1)]:
            way = antenna - points
            cosine = np.einsum("ij,ij->i", way, normals) / np.linalg.norm(way, axis=1)
            np.maximum(nearest, cosine, out=nearest)
    return np.asarray(np.degrees(np.arccos(np.clip(nearest, -1.0, 1.0))))


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("scene", type=Path)
    parser.add_argument("meshes", type=Path, nargs="+")
    parser.add_argument("--truth", type=Path, help="by default that of the scene")
    options = parser.parse_args()
    truth = read_mesh(options.truth or options.scene / TRUTH_NAME)
    capture, solid = load_capture(options.scene), MeshScene(truth.vertices, truth.faces)
    middles = cKDTree(truth.corners.mean(axis=1))
    normals = unit_normals(truth.corners)
    for path in options.meshes:
        points = sample_surface(read_mesh(path), N_SAMPLES, np.random.default_rng(0))
        distance = solid.signed_distance(points)
        _, face = middles.query(points)
        angle = angles_to_antennas(np.asarray(middles.data)[face], normals[face], capture)
        print(f"{path}\n{'degrees':>10} {'share':>6} {'level mm':>9} {'< 5 mm':>7}")
        for low, high in pairwise(BOUNDS_DEG):
            here = (angle >= low) & (angle < high)
            if here.any():
                level, close = np.median(distance[here]), np.mean(np.abs(distance[here]) < 5e-3)
                shown = f"{here.mean():6.2f} {1e3 * level:+9.2f} {close:7.2f}"
                print(f"{f'{low:g} to {high:g}':>10} {shown}")


if __name__ == "__main__":
    main()
