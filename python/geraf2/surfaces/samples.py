"""Samples of a reconstructed surface, and intervals of quantities derived from it."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from geraf2._short import Short
from geraf2._types import AnyPath, Floats
from geraf2.constants import NORMAL_95
from geraf2.geometry.triangles import enclosed_volume_m3, vertex_normals
from geraf2.io.atomic import write_npz_atomic
from geraf2.io.mesh import TriangleMesh
from geraf2.io.text import interval_text


@dataclass(frozen=True, eq=False, repr=False)
class SurfaceSamples(Short):
    """Surfaces that agree with the scan, all with the triangles of one mesh.

    The samples include shared offsets, so neighbouring vertices move together. The uncertainty of a
    quantity of the whole mesh is its spread over the samples.
    """

    mesh: TriangleMesh
    """Reconstructed surface, with expected error and evidence of each vertex."""
    displacements_m: Floats
    """Displacement of each vertex along its outward normal in each sample,
    (n_samples, n_vertices) [m]."""
    common_sigma_m: float
    """Standard deviation of the range offset that all echoes of the scan share [m]."""

    def __len__(self) -> int:
        return len(self.displacements_m)

    def meshes(self) -> Iterator[TriangleMesh]:
        """Iterate over the samples as meshes."""
        normals = vertex_normals(self.mesh.vertices, self.mesh.faces)
        for moved in self.displacements_m:
            yield replace(self.mesh, vertices=self.mesh.vertices + moved[:, None] * normals)

    def interval(
        self, quantity: Callable[[TriangleMesh], Any], *, deviations: float = NORMAL_95
    ) -> tuple[Floats, Floats]:
        """Lower and upper bound of a quantity of the surface: its value plus and minus 1.96 sigma.

        quantity: number or array of a mesh, for example its volume.
        deviations: half width of the interval in standard deviations of the samples.
        """
        if len(self) < 2:
            msg = f"an interval needs at least 2 samples, got {len(self)}"
            raise ValueError(msg)
        middle = np.asarray(quantity(self.mesh), dtype=np.float64)
        values = np.stack([np.asarray(quantity(mesh)) for mesh in self.meshes()])
        half = deviations * values.std(axis=0, ddof=1)
        return middle - half, middle + half

    def save(self, path: AnyPath) -> None:
        """Write `samples.npz`: vertices, faces, normals, displacements_m, common_offset_sigma_m."""
        arrays = {
            "vertices": self.mesh.vertices,
            "faces": self.mesh.faces,
            "normals": vertex_normals(self.mesh.vertices, self.mesh.faces),
            "displacements_m": self.displacements_m,
            "common_offset_sigma_m": np.array(self.common_sigma_m),
        }
        write_npz_atomic(path, arrays)

    def size_numbers(self) -> dict[str, Any]:
        """Volume [cm^3] and extents [mm] with their 95 % intervals.

        {} of an empty surface.
        """
        if not len(self.mesh.faces) or len(self) < 2:
            return {}

        def sizes(mesh: TriangleMesh) -> Floats:
            volume = 1e6 * enclosed_volume_m3(mesh.vertices, mesh.faces)
            return np.array([volume, *(1e3 * np.ptp(mesh.vertices, axis=0))])

        middle, (low, high) = sizes(self.mesh), self.interval(sizes)
        ends = [[round(float(a), 2), round(float(b), 2)] for a, b in zip(low, high, strict=True)]
        return {
            "volume_cm3": round(float(middle[0]), 2),
            "volume_95_percent_cm3": ends[0],
            "extents_mm": [round(float(side), 2) for side in middle[1:]],
            "extents_95_percent_mm": ends[1:],
            "common_offset_sigma_mm": round(1e3 * self.common_sigma_m, 3),
        }


def size_lines(numbers: Mapping[str, Any], confidence: float = 1.0) -> list[tuple[str, str]]:
    """Name and text of each size of a run with its interval; [] without intervals.

    numbers: entry of the stage `mesh` in run.json. confidence: probability that the run is right,
    by which that of the intervals, 95 %, is multiplied.
    """
    if "volume_95_percent_cm3" not in numbers:
        return []
    sides = " x ".join(map(_with_half, numbers["extents_mm"], numbers["extents_95_percent_mm"]))
    volume = _with_half(numbers["volume_cm3"], numbers["volume_95_percent_cm3"], " cm^3")
    share = f"({95.0 * confidence:.0f} %)"
    return [
        ("size x, y, z", f"{sides} mm {share}"),
        ("volume", f"{volume} {share}"),
        ("shared offset", f"one sigma {numbers['common_offset_sigma_mm']:.2f} mm, included"),
    ]


def _with_half(value: float, interval: tuple[float, float], unit: str = "") -> str:
    return interval_text(value, 0.5 * (interval[1] - interval[0]), unit=unit)
