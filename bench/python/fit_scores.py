"""Scores of the fit on evidence that is there: finished runs and scenes of glints without radar.

    python bench/python/fit_scores.py [--ordinary RUN=TRUTH...] [--random RUN=TRUTH...]
        [--ordinary-seeds A:B] [--random-seeds A:B] [--set FIELD=VALUE...] [--save FILE]
        [--against FILE]

Each `RUN` is a folder of `geraf2 reconstruct` with the preset fast or best, whose glints and
outlines are fitted again; each `TRUTH` is a mesh in metres. `--ordinary-seeds` and `--random-seeds`
make scenes of glints instead: from an ordinary object or one of the population every sub-aperture
gets the points whose normals meet its middle, with errors and false glints. That takes a second or
two a scene.

`--set` changes fields of `FitConfig`, and the same evidence is also fitted without it; for example,
`--set completion=smooth` leaves the completion out. The table states F1 at 5, 3 and 2 mm and the
mean of the paired differences with its standard error, of ordinary and of random objects apart.
`--save` and `--against` compare two versions of the code.
"""

import argparse
import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial import KDTree

import geraf2
from geraf2.apps.benchmark.population import parse_seeds
from geraf2.echoes.glint_set import Glints
from geraf2.echoes.noise import ECHO_NOISE, tangent_deviation
from geraf2.evaluation.mesh_metrics import sample_surface, threshold_score
from geraf2.geometry.triangles import face_areas, vertex_normals
from geraf2.io.mesh import TriangleMesh, read_mesh
from geraf2.io.planes import load_planes
from geraf2.io.run_folder import PLANES_NAME, PRIOR_NAME
from geraf2.ops.visibility import MeshScene
from geraf2.pipeline.prior import read_prior
from geraf2.pipeline.surface_samples import evidence_of_run
from geraf2.scene import LosPrior
from geraf2.scene.aperture import Aperture, apertures_at
from geraf2.simulation.ordinary import draw_ordinary
from geraf2.simulation.population import DrawnScene, draw_scene
from geraf2.simulation.scan import scan_planes
from geraf2.simulation.solids import build_solid
from geraf2.simulation.spec import ScanSpec
from geraf2.surfaces.extraction import content_surface
from geraf2.surfaces.fit import Evidence, FitConfig, fit_sdf
from geraf2.surfaces.isosurface import extract_surface
from geraf2.surfaces.pieces import separate_pieces

THRESHOLDS_M = (0.005, 0.003, 0.002)
# Points of a score, and those of the surface among which sub-apertures find the specular ones.
N_SAMPLES, N_POINTS = 10_000, 100_000
# Sub-aperture and step, distance within which it has one echo [m]; dynamic range in power.
SIZE_M, STEP_M, ECHO_M, DYNAMIC_RANGE = 0.08, 0.02, 0.018, 10.0**2.2
# Step off a surface at which a wave is no longer blocked by it [m].
OFF_M = 5e-4


# Errors of a glint, as found in runs with a known truth: an offset of its plane, along the normal
# and across it [m]; of each component of the normal; of the logarithm of the strength.
PLANE_M, ALONG_M, ACROSS_M, NORMAL_RAD, FADING = 0.5e-3, 0.7e-3, 1.5e-3, 0.08, 0.4
# False glints over true ones, the number of them in a clump, and its radius [m].
FALSE_SHARE, IN_CLUMP, CLUMP_M = 0.04, 8, 0.004


@dataclass(frozen=True, kw_only=True)
class Scene:
    name: str
    kind: str  # ordinary or random
    evidence: Evidence
    apertures: list[Aperture]
    fit: FitConfig
    prior: LosPrior | None
    truth: TriangleMesh


def scene_of_run(pair: str, kind: str) -> Scene:
    """Evidence and settings of a finished run, RUN=TRUTH."""
    run, path = map(Path, pair.split("=", 1))
    result, prior, truth = geraf2.load_run(run), read_prior(run / PRIOR_NAME), read_mesh(path)
    evidence, fit = evidence_of_run(result.run, result.record.config)
    return Scene(
        name=run.name,
        kind=kind,
        evidence=evidence,
        apertures=apertures_at(load_planes(run / PLANES_NAME).corners_m),
        fit=fit,
        prior=prior,
        truth=truth,
    )


def scene_of_object(name: str, kind: str, truth: TriangleMesh, scan: ScanSpec, seed: int) -> Scene:
    """Glints of an object by geometry, without radar."""
    rng, planes = np.random.default_rng(seed), apertures_of(scan)
    surface = *surface_points(truth, rng), MeshScene(truth.vertices, truth.faces)
    found = [(k, *e) for k, plane in enumerate(planes) for e in echoes(plane, *surface)]
    poses, positions, normals, strengths = (np.array(part) for part in zip(*found, strict=True))
    n = len(poses)
    across = ACROSS_M * rng.standard_normal((n, 3))
    across -= np.sum(across * normals, axis=1, keepdims=True) * normals
    along = PLANE_M * rng.standard_normal(len(planes))[poses] + ALONG_M * rng.standard_normal(n)
    positions += across + along[:, None] * normals
    normals += NORMAL_RAD * rng.standard_normal((n, 3))
    strengths *= np.exp(FADING * rng.standard_normal(n))

    n_clumps = int(FALSE_SHARE * n / IN_CLUMP)
    low, high = truth.vertices.min(axis=0) - 0.02, truth.vertices.max(axis=0) + 0.02
    false = np.repeat(rng.uniform(low, high, (n_clumps, 3)), IN_CLUMP, axis=0)
    false += CLUMP_M * rng.standard_normal(false.shape)
    seen_from = np.repeat(rng.integers(len(planes), size=n_clumps), IN_CLUMP)
    towards = np.array([planes[k].middle_m for k in seen_from]).reshape(-1, 3) - false
    positions, normals = np.concatenate([positions, false]), np.concatenate([normals, towards])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    glints = Glints(
        positions=positions,
        normals=normals,
        strengths=np.append(strengths, np.full(len(false), np.quantile(strengths, 0.3))),
        position_sigma_m=ECHO_NOISE.of_glints(tangent_deviation(positions, normals), 1.0)[0],
        normal_sigma_rad=np.full(len(positions), NORMAL_RAD),
        poses=np.append(poses, seen_from).astype(np.int64),
        probability=np.repeat([0.95, 0.7], [n, len(false)]),
    )
    return Scene(
        name=name,
        kind=kind,
        evidence=Evidence(glints=glints),
        apertures=planes,
        fit=FitConfig(spacing_m=0.005),
        prior=None,
        truth=truth,
    )


def apertures_of(scan: ScanSpec) -> list[Aperture]:
    """Rectangles that the antennas of the planes cover."""
    apertures = []
    for plane in scan_planes(scan):
        half = 0.5 * np.ptp((plane.tx @ plane.axes.T)[:, 1:], axis=0)
        middle = 0.5 * (plane.tx + plane.rx).mean(axis=0)
        apertures.append(Aperture.from_rectangle(middle, plane.axes, half))
    return apertures


def surface_points(
    mesh: TriangleMesh, rng: np.random.Generator, n_points: int = N_POINTS
) -> tuple[np.ndarray, np.ndarray]:
    """Points of a surface and its smooth normals there, (n_points, 3) each."""
    areas = face_areas(mesh.corners)
    face = rng.choice(len(areas), n_points, p=areas / areas.sum())
    weights = rng.dirichlet(np.ones(3), n_points)
    smooth = vertex_normals(mesh.vertices, mesh.faces)[mesh.faces[face]]
    points = np.einsum("nk,nkc->nc", weights, mesh.corners[face])
    normals = np.einsum("nk,nkc->nc", weights, smooth)
    return points, normals / np.linalg.norm(normals, axis=1, keepdims=True)


def received(
    aperture: Aperture,
    points: np.ndarray,
    directions: np.ndarray,
    blocker: MeshScene,
    step_m: float = STEP_M,
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Middle of each sub-aperture of a plane, and the waves that it receives, its middle first.

    points, directions: where waves leave a surface, and whereto, (n, 3) each.
    """
    mirror = aperture.mirror(points, directions)
    hit = np.flatnonzero(mirror.margins_m > 0.0)
    hit = hit[~blocker.occluded(points[hit] + OFF_M * directions[hit], mirror.positions_m[hit])]
    low, sides = aperture.low_m[1:], 2.0 * aperture.half_m
    n_steps = np.floor((sides - np.minimum(SIZE_M, sides)) / step_m + 1e-9)
    first = low + 0.5 * (sides - n_steps * step_m)
    local = mirror.positions_m[hit] @ aperture.axes[1:].T
    cell = np.rint((local - first) / step_m)
    inside = ((cell >= 0) & (cell <= n_steps)).all(axis=1)
    hit, local, cell = hit[inside], local[inside], cell[inside]
    off = np.linalg.norm(local - (first + cell * step_m), axis=1)
    corners, which = np.unique(cell, axis=0, return_inverse=True)
    order = np.lexsort((off, which.ravel()))
    groups = np.split(hit[order], np.cumsum(np.bincount(which.ravel()))[:-1])
    for corner, own in zip(corners, groups[: len(corners)], strict=True):
        shares = (first + corner * step_m - low) / np.maximum(aperture.half_m, 1e-9) - 1.0
        yield aperture.points_at(shares[None])[0], own


def separate(waves: np.ndarray, points: np.ndarray) -> Iterator[tuple[int, int]]:
    """First wave of each echo, and the number of waves, which is in proportion to its power.

    waves: rows of `points`, from where they seem to come, (n, 3) [m].
    """
    while len(waves):
        near = np.linalg.norm(points[waves] - points[waves[0]], axis=1) < ECHO_M
        yield int(waves[0]), int(near.sum())
        waves = waves[~near]


def echoes(
    aperture: Aperture, points: np.ndarray, normals: np.ndarray, blocker: MeshScene
) -> Iterator[tuple[np.ndarray, np.ndarray, float]]:
    """Positions, directions and strengths of the echoes of each sub-aperture of a plane."""
    for middle, waves in received(aperture, points, normals, blocker):
        found = list(separate(waves, points))
        least = max(power for _, power in found) / DYNAMIC_RANGE
        for wave, power in found:
            if power > least:
                direction = middle - points[wave]
                yield points[wave], direction / np.linalg.norm(direction), float(np.sqrt(power))


def drawn_scene(drawn: DrawnScene, kind: str) -> Scene:
    """Object and planes of a seed."""
    spec, seed = drawn.spec, drawn.record["seed"]
    return scene_of_object(f"{kind}-{seed}", kind, build_solid(spec.figure), spec.scan, seed)


def scores(scene: Scene, config: FitConfig) -> list[float]:
    """F1 at the thresholds."""
    sdf = fit_sdf(scene.evidence, config, apertures=scene.apertures, num_threads=1)
    if scene.prior is None:
        mesh = extract_surface(sdf)
    else:
        surface = content_surface(sdf, scene.prior, num_threads=1)
        mesh = separate_pieces(surface, scene.evidence.glints)[0]
    return surface_scores(mesh, scene.truth)


def surface_scores(mesh: TriangleMesh, truth: TriangleMesh) -> list[float]:
    """F1 at the thresholds of a surface."""
    if not len(mesh.faces):
        return [0.0] * len(THRESHOLDS_M)
    points = [
        sample_surface(of, N_SAMPLES, np.random.default_rng(seed))
        for seed, of in enumerate((mesh, truth))
    ]
    to_truth, to_mesh = KDTree(points[1]).query(points[0])[0], KDTree(points[0]).query(points[1])[0]
    return [threshold_score(to_truth, to_mesh, limit).f1 for limit in THRESHOLDS_M]


def differences(kinds: np.ndarray, before: np.ndarray, after: np.ndarray) -> Iterator[str]:
    """A line for each kind: means, and mean and standard error of the paired differences."""
    for kind in np.unique(kinds):
        old, new = before[kinds == kind], after[kinds == kind]
        error = (new - old).std(axis=0, ddof=1) / np.sqrt(len(old)) if len(old) > 1 else 0 * old[0]
        columns = zip(old.mean(axis=0), new.mean(axis=0), error, strict=True)
        cells = (f"{a:.3f} -> {b:.3f} ({b - a:+.3f} +- {e:.3f})" for a, b, e in columns)
        yield f"{kind:9s} {len(old):3d}  " + "   ".join(cells)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--ordinary", nargs="*", default=[], metavar="RUN=TRUTH")
    parser.add_argument("--random", nargs="*", default=[], metavar="RUN=TRUTH")
    parser.add_argument("--ordinary-seeds", type=parse_seeds, default=(), help="A:B, B excluded")
    parser.add_argument("--random-seeds", type=parse_seeds, default=(), help="A:B, B excluded")
    parser.add_argument("--set", nargs="*", default=[], dest="changes", metavar="FIELD=VALUE")
    parser.add_argument("--save", type=Path, help="write the scores of the last setting")
    parser.add_argument("--against", type=Path, help="scores to compare with, of --save")
    options = parser.parse_args()
    makers: list[Callable[[], Scene]] = [
        *(lambda p=p: scene_of_run(p, "ordinary") for p in options.ordinary),
        *(lambda p=p: scene_of_run(p, "random") for p in options.random),
        *(lambda s=s: drawn_scene(draw_ordinary(s), "ordinary") for s in options.ordinary_seeds),
        *(lambda s=s: drawn_scene(draw_scene(s), "random") for s in options.random_seeds),
    ]
    texts, fields = dict(change.split("=", 1) for change in options.changes), vars(FitConfig())
    changes = {name: type(fields[name])(text) for name, text in texts.items()}
    known, rows = json.loads(options.against.read_text()) if options.against else {}, []
    for make in makers:
        scene = make()
        after = scores(scene, replace(scene.fit, **changes))
        before = known.get(scene.name) or (scores(scene, scene.fit) if changes else after)
        rows.append((scene.name, scene.kind, before, after))
        print(f"{scene.name:32s} {np.round(before, 3)} -> {np.round(after, 3)}", flush=True)
    kinds = np.array([row[1] for row in rows])
    print("F1 at 5, 3, 2 mm, mean difference and its standard error:")
    print("\n".join(differences(kinds, *(np.array([row[k] for row in rows]) for k in (2, 3)))))
    if options.save is not None:
        options.save.write_text(json.dumps({row[0]: row[3] for row in rows}, indent=1))


if __name__ == "__main__":
    main()
