"""From a spec to a scene folder with its truth."""

from dataclasses import replace
from pathlib import Path

from geraf2._memory import require_memory
from geraf2.io.belt_file import write_belt
from geraf2.io.container import LOS_NAME, TRUTH_NAME, require_scene_folder
from geraf2.io.mesh import TriangleMesh, write_mesh
from geraf2.io.run_folder import stage_key
from geraf2.pipeline.estimates import BYTES_PER_ELEMENT, box_area_m2
from geraf2.pipeline.events import Listener
from geraf2.scene import Capture, LosPrior
from geraf2.scene.plan import rows_columns
from geraf2.scene.store import save_capture
from geraf2.simulation import SceneSpec, simulate
from geraf2.simulation.belt import belt_record

# Python with its libraries: with those of the samples, 136 to 146 MiB were the peaks of 2 to 12
# planes, within 1.2 of the estimate (`bench/python/memory.py`).
_FIXED_BYTES = 120e6
# Samples of the simulator: echoes of object and walls, noise, sum, and the scene's; positions
# beside [bytes].
_SIMULATED_BYTES_PER_SAMPLE = 48.0
_SIMULATED_BYTES_PER_ANTENNA = 400.0
# Area of an object over its height, squared.
_OBJECT_AREA = 6.0


def simulate_scene(
    spec: SceneSpec,
    out: Path | str,
    *,
    seed: int = 0,
    overwrite: bool = False,
    num_threads: int | None = None,
    listener: Listener | None = None,
) -> tuple[Capture, TriangleMesh]:
    """Simulate a metal object in boxes; write a scene with truth.ply and los.ply.

    spec: what to simulate, see :func:`geraf2.simulation.load_spec`.
    out: scene folder to make, whole or not at all; the same scene there is left as it is.
    seed: of noise, jitter, and scatterers; the same seed gives the same scene.
    overwrite: replace another scene in `out`.
    listener: hears the step "simulating".

    Returns the capture, and the object in its frame [m]. Raises UserError where the object does
    not fit into its box, or `out` holds something else.
    """
    listener = listener or Listener()
    require_simulable(spec)
    made_from = {"spec": stage_key(spec=spec), "seed": str(seed)}
    require_scene_folder(
        Path(out),
        overwrite=overwrite,
        may_be_same=lambda old: made_from.items() <= old.manifest.provenance.items(),
    )
    with listener.step("simulating") as report:
        capture, truth = simulate(spec, seed=seed, num_threads=num_threads, progress=report)
    capture = replace(capture, provenance={**capture.provenance, **made_from})
    made_from = {**made_from, "command": "geraf2 simulate"}

    def write_extras(folder: Path) -> None:
        write_mesh(truth, folder / TRUTH_NAME, frame=capture.frame, made_from=made_from)
        if capture.walls:
            wall = capture.walls[0]
            box = LosPrior.from_box(wall.size_m, wall.center_m)
            write_mesh(box.mesh, folder / LOS_NAME, frame=capture.frame, made_from=made_from)
        if spec.belt is not None:
            write_belt(folder, belt_record(spec.belt))

    save_capture(capture, out, overwrite=overwrite, extras=write_extras)
    return capture, truth


def simulate_bytes(spec: SceneSpec) -> dict[str, float]:
    """Memory that a simulation takes, by the settings that make it large."""
    scan, numerics = spec.scan, spec.numerics
    n_antennas = float(scan.sweeps.n_antennas) if scan.sweeps is not None else 0.0
    if spec.belt is not None:
        n_antennas = float(spec.belt.n_antennas)
    for ring in scan.all_rings if spec.belt is None else ():
        assert ring.aperture_m is not None
        assert ring.spacing_m is not None
        rows, columns = rows_columns(ring.aperture_m, ring.spacing_m)
        n_antennas += float(rows) * columns * ring.n_poses
    per_antenna = _SIMULATED_BYTES_PER_ANTENNA
    per_antenna += _SIMULATED_BYTES_PER_SAMPLE * spec.waveform.n_samples
    n_facets = _OBJECT_AREA * (spec.figure.height_m / numerics.max_facet_edge_m) ** 2
    wall_area = sum(box_area_m2(wall.size_m) for wall in spec.walls)
    return {
        "scan.n_poses, scan.aperture_m, scan.spacing_m, waveform.n_samples": n_antennas
        * per_antenna,
        "numerics.max_facet_edge_m": BYTES_PER_ELEMENT * n_facets,
        "numerics.wall_patch_m": BYTES_PER_ELEMENT * wall_area / numerics.wall_patch_m**2,
    }


def require_simulable(spec: SceneSpec) -> None:
    """Raise UserError, with the setting to change, where a simulation does not fit into memory."""
    parts = simulate_bytes(spec)
    largest = max(parts, key=parts.__getitem__)
    require_memory(_FIXED_BYTES + sum(parts.values()), f"change {largest} of the spec")
