"""Train the network that says which face of a plastic body each echo is of.

    python bench/python/train_faces.py make DIR --seeds A:B
    python bench/python/train_faces.py fit DIR OUT.safetensors [--seed 0] [--steps 15000]
    python bench/python/train_faces.py score WEIGHTS.safetensors DIR

`make` draws an object for each seed, turns and scales it in eight ways, scans each by planes of its
own, and writes the glints of its front and back faces with what they are. These follow from
geometry: a wave is refracted where it enters the body, comes back where it meets a face at a right
angle, and is focused by the curvature of both faces; of two echoes of a range cell only the
stronger is seen. `fit` trains the network on all files of a folder but every twelfth object, whose
glints it prints the loss of. The same files, seed and steps give the same weights within rounding.
`score` prints the share of glints whose kind is right, and the median error of the thickness, of
the objects that were left out.

The ordinary objects that decide never enter.
"""

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from scipy.spatial import KDTree
from torch import nn

import completion_objects
from fit_scores import DYNAMIC_RANGE, OFF_M, apertures_of, received, separate, surface_points
from geraf2._types import Floats
from geraf2.apps.benchmark.population import parse_seeds
from geraf2.echoes.detectability import hann_response
from geraf2.echoes.face_network import (
    AT_ONCE,
    WEIGHTS_KIND,
    WEIGHTS_VERSION,
    load_network,
    pair_features,
    token_features,
)
from geraf2.echoes.faces import MERGED, MERGED_SIGMA, SIDE_LOBE, THICK, THIN
from geraf2.errors import UserError
from geraf2.geometry.curvature import shape_operators
from geraf2.io.atomic import write_npz_atomic
from geraf2.io.checkpoint import Checkpoint, save_checkpoint
from geraf2.io.mesh import TriangleMesh
from geraf2.ops.visibility import MeshScene
from geraf2.scene.aperture import Aperture
from geraf2.simulation import random_objects
from geraf2.simulation.population_settings import POPULATION
from geraf2.simulation.spec import ScanSpec
from train_completion import centred, draw_object, draw_scan, rotation, sample_files, with_time_left

# Objects are meshed at this multiple of the usual step, which glints do not tell apart, and seen at
# fewer points and sub-apertures than those of `fit_scores.py`.
COARSER, N_POINTS, STEP_M = 2, 12_000, 0.04
# Ways in which each object is turned, scaled and scanned; of which objects some are left out.
N_WAYS, LEFT_OUT = 8, 12
# Longest side of an object, uniform in its logarithm [m], deviation of the logarithm of each side,
# how often it is turned in any way, and deviations of its place, across and up [m].
LENGTHS_M, STRETCH, TURNED, ASIDE_M, UP_M = (0.04, 0.2), 0.1, 0.25, 0.01, 0.015
INDICES = (1.55, 1.85)
# Range cell [m], and the largest angle between both faces of a body that send one echo [rad].
RANGE_CELL_M, PARALLEL = 0.042, 0.3
# Wavelength, and cell across the line of sight of a sub-aperture of 8 cm at 0.4 m [m].
WAVELENGTH_M, ACROSS_CELL_M = 0.0039, 0.0097
# Radius of the surface that gives the curvature at a point [m], and the curvature of a wave that is
# as good as plane over a sub-aperture [1/m].
CURVATURE_REACH_M, PLANE_PER_M = 0.004, 2.5
MIN_GLINTS, MAX_GLINTS = 30, 600

N_TOKEN_FEATURES, N_PAIR_FEATURES, N_BLOCKS, N_HEADS, N_WIDE, N_EDGE = 4, 14, 4, 4, 64, 24
BATCH, RATE, DECAY = 8, 2e-3, 1e-3
# Unit of the thickness [m], and factors that make first steps small.
THICKNESS_M, SHUT, COUNTED = 0.02, 2.0, 1.0 / 16.0
METAL_SHARE = 0.1
# How often strong back faces have side lobes.
LOBES = 0.25
# Weakest glints below the strong ones, in powers of ten, and the largest share of false ones, to
# the power of 2/3.
FLOOR, MOST_FALSE = (0.6, 1.5), 0.4


class Candidates(NamedTuple):
    """Echoes that some antenna would receive, (n, ...) each."""

    exits: Floats  # where the wave leaves the body [m]
    apparent: Floats  # where the echo seems to come from [m]
    towards: Floats  # direction to the antenna
    kinds: np.ndarray  # 0 front, 1 back, 2 both faces of a thin body
    thickness_m: Floats
    amplitudes: Floats


def candidates(
    points: Floats, normals: Floats, scene: MeshScene, index: float, rng: np.random.Generator
) -> Candidates:
    """Echoes of the faces at points of a surface, (n, 3), with outward normals."""
    n = len(points)
    path = scene.closest_hit(points - OFF_M * normals, -normals)[0] + OFF_M
    inside = np.isfinite(path)
    path = np.where(inside, path, 0.0)
    far = points - path[:, None] * normals
    nearest = KDTree(points).query(far)[1]
    facing = normals[nearest]
    reflection = (index - 1.0) / (index + 1.0)
    merging = RANGE_CELL_M * rng.uniform(THIN, THICK, n)
    # A wave that arrives along the normal goes straight on.
    along = -np.einsum("ij,ij->i", facing, normals)
    thin = inside & (index * path < merging) & (along > np.cos(PARALLEL))
    # Amplitude of the back's echo over the front's.
    shapes = np.nan_to_num(shape_operators(points, normals, np.arange(n), CURVATURE_REACH_M))
    per_m = 2.0 * np.pi * index * rng.uniform(*POPULATION.loss_tangent) / WAVELENGTH_M
    passed = (1.0 - reflection**2) * np.exp(-per_m * path)
    passed *= np.sqrt(focusing(normals, shapes[nearest], shapes, path, index))
    place = (MERGED + MERGED_SIGMA * rng.standard_normal(n)) * index * path
    front = Candidates(
        points,
        points - np.where(thin, place, 0.0)[:, None] * normals,
        normals,
        np.where(thin, 2, 0),
        np.where(thin, path, 0.0),
        reflection * (1.0 + np.where(thin, passed, 0.0)),
    )
    # One that is reflected at a point of the back leaves the body at the far end of its normal.
    square = 1.0 - index**2 * (1.0 - np.clip(along, -1.0, 1.0) ** 2)
    root = np.sqrt(np.maximum(square, 0.01))
    out = -index * normals + (root - index * along)[:, None] * facing
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    parallel = np.einsum("ij,ij->i", facing, out) > np.cos(PARALLEL)
    leaves = inside & (along > 0.05) & (square > 0.01) & ~((index * path < merging) & parallel)
    back = Candidates(
        far, far - index * path[:, None] * out, out, np.full(n, 1), path, reflection * passed
    )
    back = Candidates(*(values[leaves] for values in back))
    return Candidates(*(np.concatenate(pair) for pair in zip(front, back, strict=True)))


def focusing(normals: Floats, front: Floats, back: Floats, path: Floats, index: float) -> Floats:
    """Power of the echo of a back face over that of its rays as they are counted, (n,).

    A front face returns a plane wave with twice its curvature, and the rays that meet it at a right
    angle are counted by its curvature once. For a back face both follow from the paraxial matrices
    of a lens with a mirror behind it (Siegman, Lasers, 1986, section 15): of a plane wave that
    enters, and of the rays that leave the back at a right angle.

    normals: of the back face, (n, 3).
    front, back: shape operators where the wave enters and where it is reflected, (n, 3, 3).
    """
    across = np.linalg.svd(normals[:, None])[2][:, 1:]
    lens, mirror = (np.einsum("nai,nij,nbj->nab", across, s, across) for s in (front, back))
    lens, mirror = (index - 1.0) * lens, index * mirror
    unit, reduced = np.eye(2), (path / index)[:, None, None]
    at_back = unit - reduced * lens
    turned = -lens - 2.0 * mirror @ at_back
    plane = turned - lens @ (at_back + reduced * turned)
    counted = -mirror - lens @ (unit - reduced * mirror)
    sharp, many = (np.linalg.svd(value, compute_uv=False) for value in (plane, counted))
    many, sharp = np.maximum(many, PLANE_PER_M), np.maximum(sharp, 2.0 * PLANE_PER_M)
    return np.asarray(4.0 * many.prod(axis=1) / sharp.prod(axis=1))


def echoes(
    aperture: Aperture, found: Candidates, scene: MeshScene
) -> Iterator[tuple[int, Floats, float]]:
    """Candidate, middle of the sub-aperture that receives it, and strength."""
    for middle, waves in received(aperture, found.exits, found.towards, scene, STEP_M):
        powers = [
            (n_waves * float(found.amplitudes[wave]) ** 2, wave)
            for wave, n_waves in separate(waves, found.apparent)
        ]
        for power, echo in resolved(sorted(powers, key=lambda one: -one[0]), found):
            yield echo, middle, float(np.sqrt(power))


def resolved(powers: list[tuple[float, int]], found: Candidates) -> list[tuple[float, int]]:
    """Echoes, strongest first, without those that a stronger one covers or that are too weak.

    An echo is covered up to the distance at which it has twice the amplitude of the stronger one's
    main lobe: one cell where both are equal.
    """
    kept: list[tuple[float, int]] = []
    for power, echo in powers:
        if kept:
            strong, others = (np.array(values) for values in zip(*kept, strict=True))
            steps = found.apparent[echo] - found.apparent[others]
            depth = steps @ found.towards[echo]
            across = np.linalg.norm(steps - depth[:, None] * found.towards[echo], axis=1)
            lobe = hann_response(depth / RANGE_CELL_M) * hann_response(across / ACROSS_CELL_M)
            if (power < 4.0 * lobe**2 * strong).any() or power < kept[0][0] / DYNAMIC_RANGE:
                continue
        kept.append((power, echo))
    return kept


def scanned(
    mesh: TriangleMesh, scan: ScanSpec, rng: np.random.Generator
) -> dict[str, np.ndarray] | None:
    """Glints of a plastic body as they are stored; None where there are few."""
    index, scene = rng.uniform(*INDICES), MeshScene(mesh.vertices, mesh.faces, num_threads=1)
    found = candidates(*surface_points(mesh, rng, N_POINTS), scene, index, rng)
    rows = [row for aperture in apertures_of(scan) for row in echoes(aperture, found, scene)]
    if len(rows) < MIN_GLINTS:
        return None
    if len(rows) > MAX_GLINTS:
        rows = [rows[k] for k in rng.choice(len(rows), MAX_GLINTS, replace=False)]
    echo = np.array([row[0] for row in rows])
    towards = np.array([row[1] for row in rows]) - found.exits[echo]
    return {
        "positions": found.apparent[echo].astype(np.float32),
        "normals": (towards / np.linalg.norm(towards, axis=1, keepdims=True)).astype(np.float32),
        "strengths": np.array([row[2] for row in rows], dtype=np.float32),
        "kinds": found.kinds[echo].astype(np.int8),
        "thickness": found.thickness_m[echo].astype(np.float32),
        "exits": found.exits[echo].astype(np.float32),
    }


def make_samples(seed: int) -> Iterator[tuple[int, dict[str, np.ndarray]]]:
    """Glints of the object of a seed, seen in several ways."""
    drawn = draw_object(seed)[1]
    for way in range(N_WAYS):
        rng = np.random.default_rng([seed, 31, way])
        vertices = centred(drawn.vertices)
        length_m = np.exp(rng.uniform(*np.log(LENGTHS_M)))
        vertices = vertices * (length_m / np.ptp(vertices, axis=0).max())
        vertices = vertices * np.exp(rng.normal(0.0, STRETCH, 3))
        if rng.random() < TURNED:
            turn = np.linalg.qr(rng.standard_normal((3, 3)))[0]
            vertices = vertices @ (turn * np.sign(np.linalg.det(turn))).T
        vertices = vertices @ rotation(2, rng.uniform(0.0, 2.0 * np.pi)).T
        vertices = vertices + np.append(rng.normal(0.0, ASIDE_M, 2), rng.normal(0.0, UP_M))
        mesh = TriangleMesh(vertices=np.ascontiguousarray(vertices), faces=drawn.faces)
        sample = scanned(mesh, draw_scan(rng), rng)
        if sample is not None:
            yield way, sample


def make(folder: Path, seeds: range) -> None:
    """Write the samples of the seeds that have none yet."""
    random_objects._CELLS //= COARSER
    random_objects._CELL_M = tuple(COARSER * step for step in random_objects._CELL_M)
    completion_objects.STEP *= COARSER
    missing = [seed for seed in seeds if not any(folder.glob(f"{seed}_*.npz"))]
    for seed in with_time_left(missing, "object"):
        try:
            for way, sample in make_samples(seed):
                write_npz_atomic(folder / f"{seed}_{way}.npz", sample)
        except (UserError, ValueError) as error:
            print(f"seed {seed} gives no sample: {error}", flush=True)


class Glints(NamedTuple):
    """Glints of one scan that the network learns from, (n, ...) each; kind 3 is clutter."""

    positions: np.ndarray
    normals: np.ndarray
    strengths: np.ndarray
    kinds: np.ndarray
    thickness: np.ndarray

    def select(self, keep: np.ndarray) -> "Glints":
        return Glints(*(values[keep] for values in self))


def read(path: Path) -> tuple[Glints, np.ndarray]:
    """Glints of a file, and where their waves leave the body, (n, 3)."""
    with np.load(path) as z:
        own = Glints(*(z[name] for name in Glints._fields))
        return own._replace(kinds=own.kinds.astype(np.int64)), z["exits"]


def degrade(glints: Glints, exits: np.ndarray, rng: np.random.Generator) -> Glints:
    """Glints as a scan shows them: some of metal, some lost, blurred, with false ones, turned."""
    if rng.random() < METAL_SHARE:
        front = glints.kinds != 1
        glints = glints._replace(positions=exits, kinds=np.zeros_like(glints.kinds)).select(front)
    glints = lose(with_side_lobes(glints, rng), rng)
    n = min(AT_ONCE, len(glints.kinds))
    if rng.random() < 0.4:
        n = min(n, max(20, int(len(glints.kinds) * rng.uniform(0.2, 1.0))))
    glints = glints.select(rng.choice(len(glints.kinds), n, replace=False))
    blur = rng.uniform(0.3, 1.5)
    normals = glints.normals + 0.06 * blur * rng.standard_normal((n, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    positions = glints.positions + 2e-3 * blur * rng.standard_normal((n, 1)) * normals
    positions += 2e-3 * blur * rng.standard_normal((n, 3))
    false = rng.choice(n, int(n * rng.uniform(0.0, MOST_FALSE) ** 1.5), replace=False)
    kinds = glints.kinds.copy()
    kinds[false] = 3
    positions[false] = positions[rng.choice(n, len(false))] + rng.normal(0.0, 0.03, (len(false), 3))
    turn = rotation(2, rng.uniform(0.0, 2.0 * np.pi))
    if rng.random() < 0.5:
        turn = turn @ np.diag([1.0, -1.0, 1.0])
    fading = np.exp(0.4 * rng.standard_normal(n))
    return Glints(
        positions @ turn.T, normals @ turn.T, glints.strengths * fading, kinds, glints.thickness
    )


def with_side_lobes(glints: Glints, rng: np.random.Generator) -> Glints:
    """Add, in some scans, false glints in front of strong back faces.

    There the edge of the range window's main lobe and the echo of the front add up to a peak.
    """
    if rng.random() > LOBES:
        return glints
    strong = glints.strengths > 0.3 * np.quantile(glints.strengths, 0.98)
    found = np.flatnonzero((glints.kinds == 1) & strong & (rng.random(len(strong)) < rng.random()))
    false = glints.select(found)
    false = false._replace(
        positions=false.positions + SIDE_LOBE * RANGE_CELL_M * false.normals,
        strengths=false.strengths * rng.uniform(0.15, 0.33, len(found)).astype(np.float32),
        kinds=np.full(len(found), 3),
    )
    return Glints(*(np.concatenate(pair) for pair in zip(glints, false, strict=True)))


def lose(glints: Glints, rng: np.random.Generator) -> Glints:
    """Lose the weak ones, and one kind, spots or a side."""
    n, kept = len(glints.kinds), np.ones(len(glints.kinds), dtype=bool)
    way = rng.random()
    if way < 0.75:
        lost = glints.kinds == (0 if way < 0.5 else 1)
        kept &= ~(lost & (rng.random(n) < rng.uniform(0.0, 0.9)))
    for _ in range(rng.poisson(1.5)):
        off = np.linalg.norm(glints.positions - glints.positions[rng.integers(n)], axis=1)
        kept &= ~((off < rng.uniform(0.01, 0.04)) & (rng.random(n) < 0.9))
    if rng.random() < 0.5:
        side = rng.standard_normal(3)
        facing = glints.normals @ side / np.linalg.norm(side)
        kept &= ~((facing > rng.uniform(0.2, 0.8)) & (rng.random(n) < 0.9))
    least = np.quantile(glints.strengths, 0.98) * 10.0 ** -rng.uniform(*FLOOR)
    kept &= glints.strengths > least
    return glints.select(kept) if kept.sum() >= 20 else glints


Batch = tuple[torch.Tensor, ...]


def batch_of(samples: Sequence[Glints]) -> Batch:
    """Features of glints and of pairs, kinds, and thickness, padded to one length; kind -1 is none.

    What the network reads is computed by the package.
    """
    shape = len(samples), AT_ONCE
    tokens = np.zeros((*shape, N_TOKEN_FEATURES), dtype=np.float32)
    pairs = np.zeros((*shape, AT_ONCE, N_PAIR_FEATURES), dtype=np.float32)
    kinds, thickness = np.full(shape, -1), np.zeros(shape, dtype=np.float32)
    for number, own in enumerate(samples):
        n = len(own.kinds)
        tokens[number, :n] = token_features(own.positions, own.normals, own.strengths)
        pairs[number, :n, :n] = pair_features(own.positions, own.normals)
        kinds[number, :n], thickness[number, :n] = own.kinds, own.thickness
    return tuple(map(torch.from_numpy, (tokens, pairs, kinds, thickness)))


class Block(nn.Module):
    """Attention with weights by the geometry of pairs, and a layer for each glint."""

    def __init__(self) -> None:
        super().__init__()
        self.ln1, self.ln2 = nn.LayerNorm(N_WIDE), nn.LayerNorm(N_WIDE)
        self.qkv, self.edge = nn.Linear(N_WIDE, 3 * N_WIDE), nn.Linear(N_EDGE, 2 * N_HEADS)
        self.o = nn.Linear(2 * N_WIDE, N_WIDE)
        self.ff = nn.Sequential(
            nn.Linear(N_WIDE, 2 * N_WIDE), nn.SiLU(), nn.Linear(2 * N_WIDE, N_WIDE)
        )

    def forward(self, x: torch.Tensor, edges: torch.Tensor, mask: torch.Tensor) -> torch.Tensor:
        n_samples, n, _ = x.shape
        asked = self.qkv(self.ln1(x)).view(n_samples, n, 3, N_HEADS, -1).permute(2, 0, 3, 1, 4)
        query, key, value = asked
        edge = self.edge(edges).permute(0, 3, 1, 2)
        scale = (N_WIDE // N_HEADS) ** -0.5
        shares = scale * query @ key.transpose(-1, -2) + edge[:, :N_HEADS] + mask
        counted = torch.sigmoid(edge[:, N_HEADS:] - SHUT + mask)
        heads = torch.cat([shares.softmax(-1) @ value, COUNTED * (counted @ value)], dim=-1)
        x = x + self.o(heads.permute(0, 2, 1, 3).reshape(n_samples, n, -1))
        return x + self.ff(self.ln2(x))


class Network(nn.Module):
    """The network of `geraf2.echoes.face_network`, for batches and gradients."""

    def __init__(self) -> None:
        super().__init__()
        self.inp = nn.Linear(N_TOKEN_FEATURES, N_WIDE)
        self.edge = nn.Linear(N_PAIR_FEATURES, N_EDGE)
        self.blocks = nn.ModuleList([Block() for _ in range(N_BLOCKS)])
        self.ln, self.out = nn.LayerNorm(N_WIDE), nn.Linear(N_WIDE, 5)

    def forward(
        self, tokens: torch.Tensor, pairs: torch.Tensor, is_glint: torch.Tensor
    ) -> torch.Tensor:
        """Logits of the kinds and log of the thickness, (n_samples, n, 5)."""
        x, edges = self.inp(tokens), nn.functional.silu(self.edge(pairs))
        mask = torch.where(is_glint, 0.0, -1e4)[:, None, None]
        for block in self.blocks:
            x = block(x, edges, mask)
        return self.out(self.ln(x))


def losses(network: Network, batch: Batch) -> tuple[torch.Tensor, torch.Tensor]:
    """Cross entropy of the kinds, and mean error of the log of the thickness."""
    tokens, pairs, kinds, thickness = batch
    found = network(tokens, pairs, kinds >= 0)
    entropy = nn.functional.cross_entropy(found[..., :4].transpose(1, 2), kinds, ignore_index=-1)
    through = (kinds == 1) | (kinds == 2)
    true = torch.log(thickness[through].clamp(min=0.003) / THICKNESS_M)
    if not len(true):
        return entropy, torch.zeros(())
    return entropy, nn.functional.smooth_l1_loss(found[..., 4][through], true, beta=0.3)


def is_left_out(path: Path) -> bool:
    """Whether the object of a file judges."""
    return int(path.stem.partition("_")[0]) % LEFT_OUT == 7


def fit(folder: Path, out: Path, seed: int, n_steps: int) -> None:
    """Train the network and write its weights."""
    torch.manual_seed(seed)
    rng, network = np.random.default_rng(seed), Network()
    paths = sample_files(folder)
    learned, judged = ([read(p) for p in paths if is_left_out(p) == left] for left in (False, True))
    optimiser = torch.optim.AdamW(network.parameters(), lr=RATE, weight_decay=DECAY)
    schedule = torch.optim.lr_scheduler.LambdaLR(
        optimiser, lambda k: min(1.0, k / 200, max(0.01, 2.0 * (1.0 - k / n_steps)))
    )
    recent = []
    for step in with_time_left(range(1, n_steps + 1), "step"):
        drawn = rng.integers(len(learned), size=BATCH)
        entropy, error = losses(network, batch_of([degrade(*learned[k], rng) for k in drawn]))
        optimiser.zero_grad()
        (entropy + error).backward()
        nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        optimiser.step()
        schedule.step()
        recent.append((float(entropy.detach()), float(error.detach())))
        if step % 500 == 0:
            with torch.no_grad():
                own = np.random.default_rng(5)
                found = losses(network, batch_of([degrade(*one, own) for one in judged]))
            seen = np.mean(recent, axis=0)
            texts = (f"{one:.3f} and {other:.3f}" for one, other in (seen, found))
            print(f"step {step}, loss of kinds and thickness: {'; left out '.join(texts)}")
            recent.clear()
            save(network, out)
    save(network, out)


def save(network: Network, out: Path) -> None:
    """Write the weights in half precision, with the units and factors in them."""
    arrays = {name: value.numpy().copy() for name, value in network.state_dict().items()}
    arrays["out.bias"][4] += np.log(THICKNESS_M)
    for block in (f"blocks.{number}" for number in range(N_BLOCKS)):
        arrays[f"{block}.edge.bias"][N_HEADS:] -= SHUT
        # of each head: what is shared, then what is counted
        counted = arrays[f"{block}.o.weight"].reshape(N_WIDE, N_HEADS, 2, -1)[:, :, 1]
        counted *= COUNTED
    arrays = {name: array.astype(np.float16) for name, array in arrays.items()}
    stored = Checkpoint(kind=WEIGHTS_KIND, version=WEIGHTS_VERSION, arrays=arrays, header={})
    save_checkpoint(out, stored)


def score(weights: Path, folder: Path) -> None:
    """Print what the network finds on the objects that were left out."""
    network, rows, rng = load_network(weights), [], np.random.default_rng(5)
    for path in filter(is_left_out, sample_files(folder)):
        glints = degrade(*read(path), rng)
        logits, log_thickness = network(*(v.astype(np.float64) for v in glints[:3]))
        right = logits.argmax(axis=1) == glints.kinds
        through = np.isin(glints.kinds, (1, 2)) & right
        off = np.abs(log_thickness[through] - np.log(glints.thickness[through]))
        rows.append((right.mean(), np.median(off) if through.any() else np.nan))
    share, off = np.nanmean(rows, axis=0)
    print(f"{len(rows)} scans: kind right {share:.3f}, thickness within {100.0 * off:.0f} %")


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    commands = parser.add_subparsers(dest="command", required=True)
    making = commands.add_parser("make")
    making.add_argument("folder", type=Path)
    making.add_argument("--seeds", required=True)
    fitting = commands.add_parser("fit")
    fitting.add_argument("folder", type=Path)
    fitting.add_argument("out", type=Path)
    fitting.add_argument("--seed", type=int, default=0)
    fitting.add_argument("--steps", type=int, default=15_000)
    scoring = commands.add_parser("score")
    scoring.add_argument("weights", type=Path)
    scoring.add_argument("folder", type=Path)
    given = parser.parse_args()
    torch.set_num_threads(1)
    if given.command == "make":
        given.folder.mkdir(parents=True, exist_ok=True)
        make(given.folder, parse_seeds(given.seeds))
    elif given.command == "fit":
        fit(given.folder, given.out, given.seed, given.steps)
    else:
        score(given.weights, given.folder)


if __name__ == "__main__":
    main()
