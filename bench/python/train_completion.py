"""Train the network that completes surfaces where nothing was measured.

    python bench/python/train_completion.py make DIR --seeds A:B
    python bench/python/train_completion.py fit DIR OUT.safetensors [--seed 0] [--nets 16]
    python bench/python/train_completion.py score WEIGHTS.safetensors DIR

`make` writes a sample for each seed that DIR lacks. It draws an object and a scan, makes glints by
geometry as `fit_scores.py` does, degrades them as scans do, and fits them. A process uses one core;
several may fill one folder with seeds of their own. `fit` trains networks on all samples of a
folder: for voxels near a surface they learn by how much the fitted distance has to change. The same
samples and seed give the same file. `score` states F1 at 5, 3 and 2 mm of the fit and of the
completed field on samples that the networks have not seen, the mean of the paired differences with
its standard error, and the 5 % quantile of these differences, for each kind of object and for all.

The ordinary objects that decide never enter, nor do the scissors, which are much like the pliers
among them: they are there to judge with.
"""

import argparse
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
import torch
from scipy.ndimage import distance_transform_edt, gaussian_filter
from threadpoolctl import threadpool_limits

from completion_objects import MAKERS
from fit_scores import apertures_of, differences, scene_of_object, surface_scores
from geraf2._types import Floats
from geraf2.apps.benchmark.population import parse_seeds
from geraf2.echoes.glint_set import Glints
from geraf2.errors import UserError
from geraf2.fields import SdfGrid
from geraf2.freespace.silhouettes import SilhouetteConfig, Silhouettes
from geraf2.io.atomic import write_npz_atomic
from geraf2.io.checkpoint import Checkpoint, save_checkpoint
from geraf2.io.mesh import TriangleMesh
from geraf2.ops.visibility import MeshScene
from geraf2.scene import Grid
from geraf2.scene.aperture import Aperture
from geraf2.simulation.figures import FIGURES
from geraf2.simulation.ordinary import N_EACH, OBJECTS
from geraf2.simulation.population import draw_scene
from geraf2.simulation.random_objects import random_object
from geraf2.simulation.solids import build_solid
from geraf2.simulation.spec import FigureSpec, RingSpec, ScanSpec
from geraf2.surfaces.completion import (
    BAND_CM,
    WEIGHTS_KIND,
    WEIGHTS_VERSION,
    complete,
    features,
    load_network,
)
from geraf2.surfaces.fit import smooth_fit
from geraf2.surfaces.isosurface import extract_surface, signed_distances
from geraf2.surfaces.linear_sdf import CM, OrientedPoints
from geraf2.surfaces.refinement import RefineConfig, evidence_of

FIGURE_NAMES = tuple(n for n in FIGURES if n not in OBJECTS[N_EACH:] and n != "scissors")
# Share of whole scenes of the population; kinds of the other objects and their shares.
POPULATION_SHARE = 0.4
KINDS = {
    "figure": 0.2,
    "creature": 0.18,
    "vessel": 0.11,
    "container": 0.11,
    "tool": 0.07,
    "furniture": 0.07,
    "mechanical": 0.06,
    "random": 0.2,
}
# How often an object of a kind lies on its side, and how often one of another kind does.
LYING, USUALLY_LYING = {"tool": 0.6, "vessel": 0.3, "mechanical": 0.3, "random": 0.3}, 0.18
# Share of the scans with shadows on far walls, and how often one shows an axis that it could.
SHADOWED, SHOWN = 0.4, 0.8
# Half of the sides of the area that a shadow shows, least and largest [m]. Errors of its edge: one
# that all of it shares, one that changes along it, over which length, and its blur [m].
SHADOW_M = ((0.05, 0.05), (0.1, 0.12))
EDGE_SHARED_M, EDGE_RIPPLE_M, EDGE_LENGTH_M, EDGE_BLUR_M = 1e-3, 1e-3, 0.01, 2e-3
# First seeds, far from those that anything else of the project uses.
FIRST_SEED, FIRST_POPULATION, FIRST_RANDOM = 7_000_000, 600_000, 500_000
# Longest side of an object, uniform in its logarithm [m]; deviations of the logarithms of its
# three sides, and of its place from the axis of the turntable [m].
LENGTH_M, STRETCH, ASIDE_M = (0.05, 0.2), 0.12, 0.006

# Errors of glints at the middle of their range, beside those of `fit_scores.py`: of each component
# of the normal, and along it [m]. What the fit is told of both [rad, m].
NORMAL_ERROR, ALONG_ERROR_M = 0.06, 0.5e-3
STATED_NORMAL_RAD, STATED_POSITION_M = 0.08, 1e-3
# Fewer glints than these are not thinned out.
MIN_GLINTS = 40

# How the fields of outlines are named in a sample.
OUTLINE, OUTLINE_FIELDS = "outline_", tuple(field.name for field in fields(Silhouettes))

# The true distance is computed where the fit is within the first of the surface, and it is the
# second elsewhere [m].
NEAR_M, AWAY_M = 0.024, 0.03
# Voxels of a scene that train. They lie within the first of the fitted surface or within the second
# of the true one; how often they are chosen falls with the distance to the nearer one over the
# third, to no less than the fourth [cm, cm, cm, 1].
N_CHOSEN, NEAR_FIT_CM, NEAR_TRUTH_CM, FALL_CM, LEAST = 3000, 2.2, 1.0, 0.6, 0.05
# Distances count by their hyperbolic tangent over this length [cm]: far from both surfaces an error
# moves no surface.
SOFT_CM = 0.8
N_HIDDEN, N_EPOCHS, BATCH, WEIGHT_DECAY = 64, 12, 4096, 1e-3
# Largest rate of the one-cycle schedule.
RATE = 6e-3
# Added to the standard deviation of an input: one that never changes counts for nothing.
MIN_DEVIATION = 1e-3


def draw_object(seed: int) -> tuple[str, TriangleMesh, ScanSpec]:
    """Kind, surface and scan of a seed."""
    rng = np.random.default_rng(FIRST_SEED + seed)
    if rng.random() < POPULATION_SHARE:
        drawn = draw_scene(FIRST_POPULATION + seed)
        return "population", build_solid(drawn.spec.figure), drawn.spec.scan
    kind = str(rng.choice(list(KINDS), p=list(KINDS.values())))
    if kind == "figure":
        name = FIGURE_NAMES[rng.integers(len(FIGURE_NAMES))]
        mesh = build_solid(FigureSpec(name=name, height_m=0.1))
    elif kind == "random":
        mesh = random_object(FIRST_RANDOM + seed).mesh
    else:
        mesh = MAKERS[kind](rng)
    vertices = centred(mesh.vertices)
    length_m = np.exp(rng.uniform(*np.log(LENGTH_M)))
    vertices = vertices * (length_m / np.ptp(vertices, axis=0).max())
    if kind != "random":
        vertices = vertices * np.exp(rng.normal(0.0, STRETCH, 3))
    vertices = centred(turned(vertices, kind, rng)) + np.append(rng.normal(0.0, ASIDE_M, 2), 0.0)
    mesh = TriangleMesh(vertices=np.ascontiguousarray(vertices), faces=mesh.faces)
    return kind, mesh, draw_scan(rng)


def centred(vertices: np.ndarray) -> np.ndarray:
    """Move the middle of the bounding box to the origin."""
    return vertices - 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))


def turned(vertices: np.ndarray, kind: str, rng: np.random.Generator) -> np.ndarray:
    """Lay an object down, or turn it in any way, and then about the vertical."""
    lies = rng.random() < LYING.get(kind, USUALLY_LYING)
    if kind in ("random", "mechanical") and rng.random() < 0.5:
        turn = np.linalg.qr(rng.standard_normal((3, 3)))[0]
        vertices = vertices @ (turn * np.sign(np.linalg.det(turn))).T
    elif lies:
        angle = rng.choice([0.5 * np.pi, -0.5 * np.pi])
        vertices = vertices @ rotation(0 if rng.random() < 0.5 else 1, angle).T
    return vertices @ rotation(2, rng.uniform(0.0, 2.0 * np.pi)).T


def rotation(axis: int, angle: float) -> np.ndarray:
    """Rotation about a coordinate axis, (3, 3)."""
    matrix, first, second = np.eye(3), (axis + 1) % 3, (axis + 2) % 3
    matrix[first, first] = matrix[second, second] = np.cos(angle)
    matrix[second, first] = np.sin(angle)
    matrix[first, second] = -matrix[second, first]
    return matrix


def draw_scan(rng: np.random.Generator) -> ScanSpec:
    """Draw 6 to 36 planes around the object, 38 % with a ring above or below them."""
    uniform, way, rings = rng.uniform, rng.random(), ()
    n_poses = int(rng.integers(6, 12) if way < 0.15 else rng.integers(12, 37))
    if way > 0.68:
        n_above = int(rng.integers(3, 9))
        rings = (RingSpec(n_poses=n_above, elevation_deg=uniform(25.0, 50.0)),)
        if rng.random() < 0.5:
            rings += (RingSpec(elevation_deg=90.0),)
    elif way > 0.62:
        n_below = int(rng.integers(3, 9))
        rings = (RingSpec(n_poses=n_below, elevation_deg=uniform(-30.0, -15.0)),)
    return ScanSpec(
        n_poses=n_poses,
        start_angle_deg=uniform(0.0, 360.0),
        aperture_m=(uniform(0.1, 0.16), uniform(0.12, 0.25)),
        standoff_m=uniform(0.33, 0.5),
        height_m=float(rng.normal(0.0, 0.015)),
        spacing_m=0.004,
        rings=rings,
    )


def draw_outlines(mesh: TriangleMesh, scan: ScanSpec, rng: np.random.Generator) -> Silhouettes:
    """Draw the outlines of an object against two walls, of some scans."""
    spacing_m, known_m = SilhouetteConfig().spacing_m, rng.uniform(*SHADOW_M)
    counts = (known_m / spacing_m).astype(int)
    u, v = (spacing_m * np.arange(-n, n + 1) for n in counts)
    v = v + scan.height_m
    shown = [axis for axis in (0, 1) if rng.random() < SHOWN]
    axes = shown if rng.random() < SHADOWED else []
    outlines, scene = np.ones((len(axes), len(u), len(v))), MeshScene(mesh.vertices, mesh.faces)
    for number, axis in enumerate(axes):
        start = np.full((len(u), len(v), 3), -1.0)
        start[..., 1 - axis], start[..., 2] = np.meshgrid(u, v, indexing="ij")
        end = start.copy()
        end[..., axis] = 1.0
        dark = scene.occluded(start.reshape(-1, 3), end.reshape(-1, 3)).reshape(len(u), len(v))
        outside_m = distance_transform_edt(~dark) - distance_transform_edt(dark)
        ripple = gaussian_filter(rng.standard_normal(dark.shape), EDGE_LENGTH_M / spacing_m)
        outside_m = spacing_m * outside_m + EDGE_RIPPLE_M * ripple / ripple.std()
        outside_m += EDGE_SHARED_M * rng.standard_normal()
        outlines[number] = np.clip(0.5 + 0.5 * outside_m / EDGE_BLUR_M, 0.0, 1.0)
    return Silhouettes(
        axes=np.array(axes, dtype=np.int64),
        origins_m=np.tile([u[0], v[0]], (len(axes), 1)),
        spacing_m=np.array(spacing_m),
        transmission=outlines,
        known=np.ones(outlines.shape, dtype=bool),
        thresholds=np.full(len(axes), 0.5),
        reason=np.array(""),
    )


def degrade(glints: Glints, rng: np.random.Generator) -> Glints:
    """Lose glints, blur those that stay, and add false ones."""
    uniform = rng.uniform
    kept = glints.select(kept_glints(glints, rng))
    n, blur = len(kept), uniform(0.0, 1.2)
    normals = kept.normals + blur * NORMAL_ERROR * rng.standard_normal((n, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    along = blur * ALONG_ERROR_M * rng.standard_normal(n)
    positions = kept.positions + along[:, None] * normals
    probability = np.clip(rng.beta(6.0, 1.2, n), 0.5, 1.0)
    clumps = [(positions, normals, kept.strengths, kept.poses, probability)]
    low, high = positions.min(axis=0) - 0.04, positions.max(axis=0) + 0.04
    for _ in range(rng.poisson(uniform(0.0, 4.0))):
        n_false, pose = int(rng.integers(3, 25)), int(kept.poses[rng.integers(n)])
        towards = normals[kept.poses == pose].mean(axis=0)
        center = uniform(low, high)
        at = center + uniform(0.002, 0.008) * rng.standard_normal((n_false, 3))
        slant = towards + uniform(0.05, 0.35) * rng.standard_normal(3)
        slant = slant + NORMAL_ERROR * rng.standard_normal((n_false, 3))
        slant /= np.linalg.norm(slant, axis=1, keepdims=True)
        strength = np.quantile(kept.strengths, uniform(0.05, 0.7))
        shares = np.full(n_false, uniform(0.5, 0.9))
        clumps.append((at, slant, np.full(n_false, strength), np.full(n_false, pose), shares))
    joined = [np.concatenate(part) for part in zip(*clumps, strict=True)]
    positions, normals, strengths, poses, probability = joined
    return Glints(
        positions=positions,
        normals=normals,
        strengths=strengths,
        poses=poses.astype(np.int64),
        probability=probability,
        position_sigma_m=np.full(len(positions), STATED_POSITION_M),
        normal_sigma_rad=np.full(len(positions), STATED_NORMAL_RAD),
    )


def kept_glints(glints: Glints, rng: np.random.Generator) -> np.ndarray:
    """Which glints a scan with a weak radar, shadows and a coarse raster still has, (n,)."""
    uniform, n, kept = rng.uniform, len(glints), np.ones(len(glints), dtype=bool)
    if rng.random() < 0.5:  # a smaller dynamic range
        kept &= glints.strengths > glints.strengths.max() * 10.0 ** (-uniform(8.0, 22.0) / 20.0)
    if rng.random() < 0.75:  # spots of which most echoes are lost
        for _ in range(rng.poisson(3) + 1):
            center, radius_m = glints.positions[rng.integers(n)], uniform(0.006, 0.032)
            near = np.linalg.norm(glints.positions - center, axis=1) < radius_m
            kept &= ~(near & (rng.random(n) < uniform(0.6, 1.0)))
    if rng.random() < 0.5:  # some echoes anywhere
        kept &= rng.random(n) < uniform(0.1, 1.0)
    if rng.random() < 0.3:  # a side from which little came
        side = rng.standard_normal(3)
        side /= np.linalg.norm(side)
        faces = glints.normals @ side > uniform(0.2, 0.8)
        kept &= ~(faces & (rng.random(n) < uniform(0.5, 1.0)))
    return kept if kept.sum() >= MIN_GLINTS else np.ones(n, dtype=bool)


def make_sample(seed: int) -> dict[str, np.ndarray]:
    """Fitted field, true distances, glints, planes and surface of a seed, as they are stored."""
    kind, mesh, scan = draw_object(seed)
    scene = scene_of_object(kind, kind, mesh, scan, seed)
    rng = np.random.default_rng(seed)
    glints, outlines = degrade(scene.evidence.glints, rng), draw_outlines(mesh, scan, rng)
    evidence = evidence_of(glints, outlines, RefineConfig())
    sdf, points = smooth_fit(evidence, scene.fit, num_threads=1)
    truth, near = np.full(sdf.values.shape, AWAY_M), np.abs(sdf.values) < NEAR_M
    at = sdf.grid.points()[near.ravel()]
    truth[near] = signed_distances(mesh, at, num_threads=1)
    planes = [np.concatenate([a.middle_m, *a.axes, a.half_m]) for a in apertures_of(scan)]
    return {
        "f": sdf.values,
        "t": truth.astype(np.float32),
        "origin": np.asarray(sdf.grid.origin_m),
        "spacing": np.asarray(sdf.grid.spacing_m),
        "positions": points.positions,
        "normals": points.normals,
        "weights": points.normal_weights,
        "planes": np.array(planes),
        "vertices": mesh.vertices.astype(np.float32),
        "faces": mesh.faces.astype(np.int32),
        "kind": np.asarray(kind),
        **{OUTLINE + name: getattr(evidence.outlines, name) for name in OUTLINE_FIELDS},
    }


@dataclass(frozen=True, kw_only=True, eq=False)
class Sample:
    """A scene whose object is known."""

    kind: str
    sdf: SdfGrid
    truth_m: Floats
    """True signed distance at each voxel [m]."""
    points: OrientedPoints
    apertures: Sequence[Aperture]
    outlines: Silhouettes
    mesh: TriangleMesh

    @classmethod
    def read(cls, path: Path) -> "Sample":
        """Read a file that `make` wrote."""
        with np.load(path) as stored:
            z = dict(stored)
        shape = z["f"].shape
        grid = Grid(origin_m=tuple(z["origin"]), spacing_m=float(z["spacing"]), shape=shape)
        planes = [(p[:3], p[3:12].reshape(3, 3), p[12:]) for p in z["planes"]]
        weights = z["weights"]
        return cls(
            kind=str(z["kind"]),
            sdf=SdfGrid(grid=grid, values=z["f"]),
            truth_m=z["t"].astype(np.float64),
            points=OrientedPoints(
                positions=z["positions"],
                normals=z["normals"],
                position_weights=weights,
                normal_weights=weights,
            ),
            apertures=[Aperture.from_rectangle(*plane) for plane in planes],
            outlines=Silhouettes(**{name: z[OUTLINE + name] for name in OUTLINE_FIELDS}),
            mesh=TriangleMesh(
                vertices=z["vertices"].astype(np.float64), faces=z["faces"].astype(np.int64)
            ),
        )

    @property
    def evidence(self) -> tuple[SdfGrid, OrientedPoints, Sequence[Aperture], Silhouettes]:
        """What the completion reads."""
        return self.sdf, self.points, self.apertures, self.outlines


def sample_files(folder: Path) -> list[Path]:
    """All samples of a folder, in one order everywhere."""
    found = sorted(path for path in folder.glob("*.npz") if ".tmp" not in path.name)
    if not found:
        raise UserError(what="holds no samples", where=folder, hint="make some with `make`")
    return found


def with_time_left(items: Sequence, label: str) -> Iterator:
    """Items, with a line after each fiftieth of them that says how much time is left."""
    start, step = time.monotonic(), max(1, len(items) // 50)
    for number, item in enumerate(items, start=1):
        yield item
        if number % step == 0 or number == len(items):
            left = (time.monotonic() - start) * (len(items) - number) / number
            print(f"{label} {number} of {len(items)}, {left / 60:.0f} min left", flush=True)


def make(folder: Path, seeds: range) -> None:
    """Write the samples that are not there yet."""
    missing = [seed for seed in seeds if not (folder / f"{seed}.npz").exists()]
    for seed in with_time_left(missing, "sample"):
        try:
            sample = make_sample(seed)
        except (UserError, ValueError) as error:  # too few planes meet a normal of the object
            print(f"seed {seed} gives no sample: {error}", flush=True)
            continue
        write_npz_atomic(folder / f"{seed}.npz", sample)


def training_rows(path: Path, seed: int) -> Floats:
    """Inputs, fitted and true distance [cm] of the voxels that train, (n, n_inputs + 2)."""
    sample, rng = Sample.read(path), np.random.default_rng(seed)
    fitted, truth = (
        of.ravel().astype(np.float64) * CM for of in (sample.sdf.values, sample.truth_m)
    )
    band = np.abs(fitted) < BAND_CM
    fitted, truth = fitted[band], truth[band]
    from_fit, from_truth = np.abs(fitted), np.abs(truth)
    near = np.flatnonzero((from_fit < NEAR_FIT_CM) | (from_truth < NEAR_TRUTH_CM))
    likely = np.exp(-np.minimum(from_fit, from_truth)[near] / FALL_CM) + LEAST
    n_chosen = min(N_CHOSEN, len(near))
    chosen = rng.choice(near, n_chosen, replace=False, p=likely / likely.sum())
    inputs = features(*sample.evidence, chosen=chosen)[0]
    return np.column_stack([inputs, fitted[chosen], truth[chosen]]).astype(np.float32)


@dataclass(frozen=True, eq=False)
class Voxels:
    """What networks learn from."""

    inputs: torch.Tensor
    """With mean 0 and deviation 1, (n, n_inputs)."""
    fitted_cm: torch.Tensor
    """(n,) [cm]."""
    truth_cm: torch.Tensor
    """(n,) [cm]."""
    scenes: np.ndarray
    """Number of the scene of each voxel, (n,)."""

    def of_half(self, seed: int) -> torch.Tensor:
        """Voxels of half of the scenes, drawn by a seed."""
        drawn = np.random.default_rng(seed).random(self.scenes[-1] + 1) < 0.5
        return torch.from_numpy(np.flatnonzero(drawn[self.scenes]))

    def loss(self, change_cm: torch.Tensor, of: torch.Tensor | slice = slice(None)) -> torch.Tensor:
        """Mean difference of the softened distances, corrected and true."""
        found = torch.tanh((self.fitted_cm[of] + change_cm) / SOFT_CM)
        return (found - torch.tanh(self.truth_cm[of] / SOFT_CM)).abs().mean()


def trained(voxels: Voxels, seed: int) -> torch.nn.Sequential:
    """Train one network on half of the scenes; it first changes nothing."""
    torch.manual_seed(seed)
    half, n_inputs = voxels.of_half(seed), voxels.inputs.shape[1]
    net = torch.nn.Sequential(
        torch.nn.Linear(n_inputs, N_HIDDEN),
        torch.nn.ReLU(),
        torch.nn.Linear(N_HIDDEN, N_HIDDEN),
        torch.nn.ReLU(),
        torch.nn.Linear(N_HIDDEN, 1),
    )
    torch.nn.init.zeros_(net[-1].weight)
    torch.nn.init.zeros_(net[-1].bias)
    n_steps = max(1, N_EPOCHS * len(half) // BATCH)
    optimiser = torch.optim.AdamW(net.parameters(), weight_decay=WEIGHT_DECAY)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, RATE, total_steps=n_steps + 1)
    for _ in range(n_steps):
        batch = half[torch.randint(len(half), (BATCH,))]
        loss = voxels.loss(net(voxels.inputs[batch])[:, 0], batch)
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        schedule.step()
    return net


def fit(folder: Path, out: Path, seed: int, n_nets: int) -> None:
    """Train networks on all samples of a folder and write them into one file."""
    start, paths = time.process_time(), sample_files(folder)
    parts = [training_rows(path, seed) for path in with_time_left(paths, "features")]
    read = time.process_time() - start
    scenes = np.repeat(np.arange(len(parts)), [len(part) for part in parts])
    rows = np.concatenate(parts)
    mean = rows[:, :-2].mean(axis=0, dtype=np.float64)
    scale = 1.0 / (rows[:, :-2].std(axis=0, dtype=np.float64) + MIN_DEVIATION)
    inputs = ((rows[:, :-2] - mean) * scale).astype(np.float32)
    columns = (np.ascontiguousarray(part) for part in (inputs, rows[:, -2], rows[:, -1]))
    voxels = Voxels(*(torch.from_numpy(column) for column in columns), scenes)
    numbers = range(n_nets * seed, n_nets * (seed + 1))  # no two seeds share a network
    nets = [trained(voxels, number) for number in with_time_left(numbers, "network")]
    arrays = {"mean": mean.astype(np.float32), "scale": scale.astype(np.float32)}
    for k, layer in enumerate((0, 2, 4)):
        arrays[f"matrix_{k}"] = np.stack([net[layer].weight.detach().numpy() for net in nets])
        arrays[f"offset_{k}"] = np.stack([net[layer].bias.detach().numpy() for net in nets])
    header = {"scenes": len(paths), "voxels": len(rows), "seed": seed}
    checkpoint = Checkpoint(
        kind=WEIGHTS_KIND, version=WEIGHTS_VERSION, arrays=arrays, header=header
    )
    save_checkpoint(out, checkpoint)
    change = torch.from_numpy(load_network(out).change_cm(rows[:, :-2]))
    before, after = (float(voxels.loss(of)) for of in (torch.zeros_like(change), change))
    used = time.process_time() - start
    print(f"{len(paths)} scenes, {len(rows)} voxels, loss {before:.4f} -> {after:.4f}")
    print(f"{used:.0f} s of CPU time, {read:.0f} s of them for the inputs")


def score(weights: Path, folder: Path) -> None:
    """Print what networks gain on samples, which must not be those that trained them."""
    network, rows = load_network(weights), []
    for path in with_time_left(sample_files(folder), "scored"):
        sample = Sample.read(path)
        completed = complete(*sample.evidence, network=network)
        pair = [surface_scores(extract_surface(of), sample.mesh) for of in (sample.sdf, completed)]
        rows.append((sample.kind, *pair))
    kinds = np.array([row[0] for row in rows])
    before, after = (np.array([row[k] for row in rows]) for k in (1, 2))
    print("F1 at 5, 3, 2 mm: mean, its change and standard error; 5 % quantile of the changes")
    for groups in (kinds, np.full(len(rows), "all")):
        lines = differences(groups, before, after)
        for kind, line in zip(np.unique(groups), lines, strict=True):
            worst = np.quantile((after - before)[groups == kind], 0.05, axis=0)
            print(line + "   " + " ".join(f"{of:+.3f}" for of in worst))


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    commands = parser.add_subparsers(dest="command", required=True)
    making = commands.add_parser("make", help="make samples")
    making.add_argument("folder", type=Path)
    making.add_argument("--seeds", type=parse_seeds, required=True, help="A:B, B excluded")
    fitting = commands.add_parser("fit", help="train networks on samples")
    fitting.add_argument("folder", type=Path)
    fitting.add_argument("out", type=Path)
    fitting.add_argument("--seed", type=int, default=0)
    fitting.add_argument("--nets", type=int, default=16, help="networks that have to agree")
    scoring = commands.add_parser("score", help="score networks on other samples")
    scoring.add_argument("weights", type=Path)
    scoring.add_argument("folder", type=Path)
    options = parser.parse_args()
    torch.set_num_threads(1)
    with threadpool_limits(1):
        if options.command == "make":
            make(options.folder, options.seeds)
        elif options.command == "fit":
            fit(options.folder, options.out, options.seed, options.nets)
        else:
            score(options.weights, options.folder)


if __name__ == "__main__":
    main()
