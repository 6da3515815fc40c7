"""Scores of a run against the truth."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from geraf2.errors import UserError
from geraf2.evaluation import MeshMetrics, evaluate_mesh, write_metrics
from geraf2.io.mesh import TriangleMesh, read_mesh
from geraf2.io.planes import load_planes
from geraf2.io.run_folder import (
    ERRORS_NAME,
    FIGURES_FOLDER,
    METRICS_NAME,
    PLANES_NAME,
    REPORT_FILES,
    mesh_digest,
)
from geraf2.pipeline.events import Listener
from geraf2.pipeline.reconstruction import Reconstruction, as_triangles, load_run
from geraf2.scene.aperture import apertures_at

if TYPE_CHECKING:
    import trimesh


def evaluate(
    run: Reconstruction | Path | str,
    truth: "TriangleMesh | trimesh.Trimesh | Path | str",
    *,
    n_samples: int = 10000,
    seed: int | None = None,
    report: bool = True,
    num_threads: int | None = None,
    listener: Listener | None = None,
) -> MeshMetrics:
    """Measure the content of a run against the truth; nothing is aligned, scaled or cropped.

    Parameters
    ----------
    run
        A reconstruction, or its folder, which gets `metrics.json`.
    truth
        True surface in metres in the capture's frame: a mesh, also of trimesh, or its file.
    n_samples
        Number of points drawn from each surface.
    seed
        Seed of these points; that of the run when None.
    report
        Draw the report again, with the truth in it.
    num_threads
        Threads of the kernels; all when None.
    listener
        Receives progress and warnings.

    Returns
    -------
    MeshMetrics
        F1 at several distances [m], the Chamfer distance [1e-3 m^2], and errors of volume, extents
        and offset, each with its definition.

    Raises
    ------
    UserError
        If the run has no mesh, the truth is no mesh, or another command writes into the folder.

    Examples
    --------
    >>> capture, truth = geraf2.examples.small_capture()
    >>> metrics = geraf2.evaluate(geraf2.examples.small_run(), truth, report=False)
    >>> metrics.f1(0.005) > 0.8  # at 5 mm
    True
    """
    listener = listener or Listener()
    result = run if isinstance(run, Reconstruction) else load_run(run)
    if n_samples < 1:
        raise UserError(what="--n-samples must be at least 1", got=n_samples)
    if seed is not None and seed < 0:
        raise UserError(what="--seed must not be negative", got=seed)
    true = read_mesh(truth) if isinstance(truth, Path | str) else as_triangles(truth, "truth")
    folder = result.path
    with result.run.lock():
        now = load_run(folder)  # `result` may have been read before another run replaced the mesh
        mesh, of_mesh = now.content_mesh, mesh_digest(folder)
        seed = now.record.options.seed if seed is None else seed
        _warn_of_unit(mesh, true, listener)
        with listener.step("evaluating"):
            metrics = evaluate_mesh(
                mesh,
                true,
                n_samples=n_samples,
                seed=seed,
                planes=apertures_at(load_planes(folder / PLANES_NAME).corners_m),
                num_threads=num_threads,
            )
        with result.run.rewrite(METRICS_NAME, *REPORT_FILES):
            (folder / FIGURES_FOLDER / ERRORS_NAME).unlink(missing_ok=True)  # of an earlier truth
            write_metrics(metrics, folder / METRICS_NAME, extra=of_mesh)
            scores = {name: round(score, 6) for name, score in metrics.headline().items()}
            result.run.log("evaluate", level="info", **scores)
            if report:
                from geraf2.report import write_report  # noqa: PLC0415 - matplotlib takes 0.5 s

                with listener.step("drawing the report"):
                    write_report(folder, truth=true, num_threads=num_threads)
    return metrics


def _warn_of_unit(mesh: TriangleMesh, truth: TriangleMesh, listener: Listener) -> None:
    sizes = [float(np.ptp(m.vertices, axis=0).max()) for m in (mesh, truth)]
    if sizes[1] > 20 * sizes[0] or sizes[0] > 20 * sizes[1]:
        listener.warning(
            f"the truth is {sizes[1]:.3g} m long, the mesh {sizes[0]:.3g} m: "
            "is the truth in metres?"
        )
