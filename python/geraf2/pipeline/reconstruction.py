"""Result of a run, for Python."""

import sys
import webbrowser
from functools import cached_property
from html import escape
from pathlib import Path
from tempfile import mkdtemp
from typing import TYPE_CHECKING, Any

import numpy as np

from geraf2.echoes import Glints
from geraf2.errors import UserError
from geraf2.fields import SdfGrid
from geraf2.io.atomic import write_text_atomic
from geraf2.io.mesh import VERTEX_COLUMNS, TriangleMesh, merge_duplicate_vertices, read_mesh
from geraf2.io.run_folder import (
    BOX_NAME,
    CONFIG_NAME,
    CONTENT_NAME,
    GLINTS_NAME,
    PRIOR_NAME,
    REPORT_NAME,
    SDF_NAME,
    RunFolder,
)
from geraf2.io.verdict import Verdict
from geraf2.pipeline.prior import read_prior
from geraf2.pipeline.run_record import RunRecord
from geraf2.scene import LosPrior
from geraf2.surfaces.stated_score import score_of

if TYPE_CHECKING:
    import trimesh

    from geraf2.surfaces.samples import SurfaceSamples


class Reconstruction:
    """Result of a run, read from its folder on first use; lengths in metres.

    A missing mesh is a UserError; missing sdf, glints and report are None.

    Examples
    --------
    >>> result = geraf2.examples.small_run()
    >>> error_m = result.content.vertex_attributes["expected_error_m"]
    >>> error_m.shape == result.content.vertices.shape[:1], result.sdf.values.ndim
    (True, 3)
    >>> {"calibration", "glints", "mesh", "sdf"} <= set(result.numbers), result.report
    (True, None)
    """

    def __init__(self, run: RunFolder) -> None:
        self.run = run
        """Record of the run: steps, files, warnings."""

    def __repr__(self) -> str:
        judged = "not judged" if self.verdict is None else str(self.verdict)
        return f"Reconstruction({str(self.path)!r}, scene {self.run.scene_name!r}; {judged})"

    @property
    def path(self) -> Path:
        """Run folder."""
        return self.run.path

    @cached_property
    def content(self) -> "trimesh.Trimesh":
        """Mesh of the content, in the capture's frame [m].

        `vertex_attributes` holds arrays (n_vertices,). `expected_error_m` is one standard deviation
        of the distance to the true surface [m]. `evidence` is the basis of a vertex: 0 not seen,
        1 outline, 2 seen. `confidence` is the probability that its piece exists. Presets that
        cannot estimate them have none.
        """
        return _as_trimesh(self.content_mesh)

    @cached_property
    def box(self) -> "trimesh.Trimesh":
        """Mesh of the box around it [m]."""
        return _as_trimesh(self._mesh(BOX_NAME))

    @cached_property
    def content_mesh(self) -> TriangleMesh:
        """The content as geraf2's own mesh type: vertices, faces, expected errors [m]."""
        return self._mesh(CONTENT_NAME)

    @cached_property
    def sdf(self) -> SdfGrid | None:
        """Signed distance to the content, negative inside [m]; None for an open surface."""
        path = self.run.find_file(SDF_NAME)
        return SdfGrid.load(path) if path else None

    @cached_property
    def glints(self) -> Glints | None:
        """Oriented points; None for a preset without glints."""
        path = self.run.find_file(GLINTS_NAME)
        return Glints.load(path) if path else None

    @cached_property
    def prior(self) -> LosPrior:
        """Outside of the box that the run used."""
        return read_prior(self.path / PRIOR_NAME)

    @cached_property
    def record(self) -> RunRecord:
        """Request of the run."""
        return RunRecord.read(self.path / CONFIG_NAME)

    def samples(self, n: int = 24, *, seed: int = 0) -> "SurfaceSamples":
        """Draw surfaces that the scan allows, all with the triangles of `content_mesh`.

        The samples include the offset that all echoes of the scan share. The uncertainty of any
        quantity of the mesh is its spread over the samples.

        Parameters
        ----------
        n
            Number of surfaces, at least 2; each takes 10 to 25 ms on one core.
        seed
            Seed of the draws.

        Returns
        -------
        SurfaceSamples
            Displacements of the vertices along their normals, (n, n_vertices) [m].

        Raises
        ------
        UserError
            For a preset without glints, and for a single sample.

        Examples
        --------
        >>> samples = geraf2.examples.small_run().samples(8)
        >>> low, high = samples.interval(lambda mesh: mesh.vertices[:, 2].max())  # 95 % [m]
        >>> samples.displacements_m.shape[0], bool(low < high)
        (8, True)
        """
        from geraf2.pipeline.surface_samples import samples_of_run  # noqa: PLC0415 - imports the fits

        return samples_of_run(
            self.run, self.content_mesh, self.record.config, n_samples=n, seed=seed
        )

    @property
    def numbers(self) -> dict[str, dict[str, Any]]:
        """By stage: seconds, cpu_seconds [s], peak_memory_mib [MiB], and numbers of the result.

        Of a result that is not to be trusted, expected errors and intervals are left out.
        """
        stated = self.run.numbers
        return {
            name: {
                "seconds": record.seconds,
                "cpu_seconds": record.cpu_seconds,
                "peak_memory_mib": record.peak_memory_mib,
                **stated[name],
            }
            for name, record in self.run.stages.items()
        }

    @property
    def verdict(self) -> Verdict | None:
        """How far the result can be trusted, why, and what to do; None where it was not judged."""
        return self.run.verdict

    @property
    def stated_f1(self) -> tuple[float, float, float] | None:
        """F1 at 5 mm: lower end of the 90 % interval, median and upper end, 0 to 1.

        It includes the probability that the result is wrong. None where the result was not judged
        or is not to be trusted, and for presets that state no errors.
        """
        return None if self.verdict is None else score_of(self.content_mesh, self.verdict)

    @property
    def report(self) -> Path | None:
        """Path of `report.html`, or None."""
        path = self.path / REPORT_NAME
        return path if path.is_file() else None

    def show(self) -> Path | None:
        """Show the content in 3D: in a notebook below the cell, elsewhere in a browser.

        Returns
        -------
        Path or None
            The page that the browser shows, a temporary file; None in a notebook.

        Raises
        ------
        UserError
            If the run has no surface.
        """
        page = self._view()
        if page is None:
            raise UserError(
                what="the run has no surface to show",
                where=self.path,
                hint="make one with 'geraf2 reconstruct'",
            )
        notebook = sys.modules.get("IPython")
        if notebook is not None and notebook.get_ipython() is not None:
            notebook.display.display(self)
            return None
        path = Path(mkdtemp(prefix="geraf2-view-")) / "view.html"
        write_text_atomic(path, page)
        webbrowser.open(path.resolve().as_uri())
        return path

    def _repr_html_(self) -> str:
        """Frame of a notebook with the 3D view; text if there is no surface."""
        page = self._view()
        if page is None:
            return f"<pre>{escape(repr(self))}</pre>"
        return (
            f'<iframe title="geraf2: the content in 3D" srcdoc="{escape(page)}" '
            'sandbox="allow-scripts allow-downloads" '
            'style="width:100%;height:700px;border:0"></iframe>'
        )

    def _view(self) -> str | None:
        from geraf2.report import run_view  # noqa: PLC0415 - matplotlib takes 0.5 s

        return run_view(self.path)

    def _mesh(self, name: str) -> TriangleMesh:
        path = self.run.find_file(name)
        if path is None:
            raise UserError(
                what=f"the run has no {name}",
                where=self.path,
                hint="make it with 'geraf2 reconstruct'",
            )
        return read_mesh(path)


def load_run(path: Path | str) -> Reconstruction:
    """Open the folder of a run.

    Parameters
    ----------
    path
        The folder, argument `out` of `reconstruct`; nothing in it changes.

    Returns
    -------
    Reconstruction
        The result, lengths in metres.

    Raises
    ------
    UserError
        If the folder is no run, holds an unfinished training, or has another version.

    Examples
    --------
    >>> geraf2.load_run(geraf2.examples.small_run().path).box.is_watertight
    True
    """
    return Reconstruction(RunFolder.read(Path(path)))


def as_triangles(mesh: "TriangleMesh | trimesh.Trimesh", name: str) -> TriangleMesh:
    """Convert a mesh of trimesh, with duplicate vertices merged; UserError for other types."""
    if isinstance(mesh, TriangleMesh):
        return mesh
    vertices = np.asarray(getattr(mesh, "vertices", ()), dtype=np.float64)
    faces = np.asarray(getattr(mesh, "faces", ()), dtype=np.int64)
    if len(faces) == 0 or not np.isfinite(vertices).all():
        raise UserError(
            what=f"the {name} must be a mesh with triangles and finite vertices [m]",
            got=type(mesh).__name__,
        )
    return merge_duplicate_vertices(TriangleMesh(vertices=vertices, faces=faces))


def _as_trimesh(mesh: TriangleMesh) -> "trimesh.Trimesh":
    import trimesh  # noqa: PLC0415 - takes 0.3 s

    made = trimesh.Trimesh(vertices=mesh.vertices, faces=mesh.faces, process=False)
    for name, kind in VERTEX_COLUMNS.items():
        values = getattr(mesh, name)
        if values is not None:
            made.vertex_attributes[name] = values.astype(kind)
    return made
