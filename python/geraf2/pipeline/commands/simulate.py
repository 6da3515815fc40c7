"""From a spec to a scene folder with its truth."""

from dataclasses import replace
from pathlib import Path

from geraf2.apps.photos.photo_store import save_photos
from geraf2.io.atomic import atomic_folder
from geraf2.io.container import LOS_NAME, PHOTOS_NAME, TRUTH_NAME, require_scene_folder
from geraf2.io.mesh import TriangleMesh, write_mesh
from geraf2.io.run_folder import stage_key
from geraf2.pipeline.estimates import require_simulable
from geraf2.pipeline.events import Listener
from geraf2.scene import Capture, LosPrior
from geraf2.scene.store import save_capture
from geraf2.simulation import SceneSpec, simulate, simulate_photos


def simulate_scene(
    spec: SceneSpec,
    out: Path | str,
    *,
    seed: int = 0,
    overwrite: bool = False,
    num_threads: int | None = None,
    listener: Listener | None = None,
) -> tuple[Capture, TriangleMesh]:
    """Simulate a metal figure in boxes; write a scene with truth.ply, los.ply and photos.

    spec: what to simulate, see :func:`geraf2.simulation.load_spec`.
    out: scene folder to make, whole or not at all; the same scene there is left as it is.
    seed: of noise, jitter, scatterers and photos; the same seed gives the same scene.
    overwrite: replace another scene in `out`.
    num_threads: all cores when None.
    listener: hears the steps "simulating" and "photographing".

    Returns the capture, and the figure in its frame [m]. Raises UserError where the figure does
    not fit into its box, or `out` holds something else.
    """
    listener = listener or Listener()
    require_simulable(spec)
    made_from = {"spec": stage_key(spec=replace(spec, photos=None)), "seed": str(seed)}
    require_scene_folder(
        Path(out),
        overwrite=overwrite,
        may_be_same=lambda old: made_from.items() <= old.manifest.provenance.items(),
    )
    with listener.step("simulating") as report:
        capture, truth = simulate(
            spec, seed=seed, num_threads=num_threads, progress=lambda i, n: report(i / n)
        )
    capture = replace(capture, provenance={**capture.provenance, **made_from})
    photos = None
    if spec.photos is not None:
        with listener.step("photographing") as report:
            photos = simulate_photos(
                spec.photos,
                capture.walls,
                seed=seed,
                content=truth,
                num_threads=num_threads,
                progress=lambda i, n: report(i / n),
            )

    made_from = {**made_from, "command": "geraf2 simulate"}

    def write_extras(folder: Path) -> None:
        write_mesh(truth, folder / TRUTH_NAME, frame=capture.frame, made_from=made_from)
        if capture.walls:
            wall = capture.walls[0]
            box = LosPrior.from_box(wall.size_m, wall.center_m)
            write_mesh(box.mesh, folder / LOS_NAME, frame=capture.frame, made_from=made_from)
        if photos is not None:
            save_photos(photos, folder / PHOTOS_NAME)

    written = save_capture(capture, out, overwrite=overwrite, extras=write_extras)
    if photos is not None and not written:  # the same capture was there, maybe without photos
        with atomic_folder(Path(out) / PHOTOS_NAME) as folder:
            save_photos(photos, folder)
    return capture, truth
