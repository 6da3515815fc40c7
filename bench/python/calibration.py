"""How often the stated 95 % intervals of the calibration hold the truth.

    python bench/python/calibration.py --coverage 200

Small simulated scans of bulged boxes (12 planes at 6 mm, bulges up to 2 mm) whose delay is up to
8 mm off and whose prior is turned by up to 1.5 degrees and moved by up to 2 mm; ten draws of these
of each scan.
"""

import argparse
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from geraf2.calibration.wall_alignment import GROUPS, AlignmentConfig, WallProblem
from geraf2.imaging.peaks import KeptPeaks
from geraf2.scene import Capture, LosPrior, Wall
from geraf2.simulation import (
    FigureSpec,
    NumericsSpec,
    ScanSpec,
    SceneSpec,
    WorldSpec,
    simulate,
)

COVERAGE_BOX_M = (0.18, 0.18, 0.18)
DRAWS_PER_SCAN = 10


def coverage(n_scans: int) -> None:
    """Share of the stated 95 % intervals that hold the truth, and errors over sigma."""
    rng = np.random.default_rng(0)
    names = ("delay", "turn about z", "shift along x", "shift along y")
    scaled: list[list[float]] = []
    millimetres: list[float] = []
    for number in range(n_scans):
        if number % DRAWS_PER_SCAN == 0:
            capture = _bulged_scan(number, rng)
        errors = rng.uniform(-1.0, 1.0, 4) * [0.008, np.deg2rad(1.5), 0.002, 0.002]
        prior = LosPrior.from_box(COVERAGE_BOX_M, walls=capture.walls)
        turn = Rotation.from_rotvec([0.0, 0.0, errors[1]])
        shift = np.array([errors[2], errors[3], 0.0])
        late = replace(
            capture.waveform, path_bias_m=capture.waveform.path_bias_m + float(errors[0])
        )
        moved = replace(prior, vertices=turn.apply(prior.vertices) + shift)
        problem = WallProblem(
            replace(capture, waveform=late), moved, AlignmentConfig(), KeptPeaks(moved)
        )
        found = problem.result(problem.fit(GROUPS))
        off = [
            found.delay_m + errors[0],
            found.rotation_rad[2] + errors[1],
            *(found.translation_m + shift)[:2],
        ]
        sigmas = [found.delay_sigma_m, found.rotation_sigma_rad[2], *found.translation_sigma_m[:2]]
        scaled.append([o / s for o, s in zip(off, sigmas, strict=True)])
        millimetres.append(1e3 * off[0])
    each = np.asarray(scaled)
    print(f"| {n_scans} scans | in the 95 % interval | rms error / sigma |\n|---|---|---|")
    for name, column in zip(names, each.T, strict=True):
        share = 100.0 * np.mean(np.abs(column) < 1.96)
        print(f"| {name} | {share:.1f} % | {np.sqrt(np.mean(column**2)):.2f} |")
    print(f"delay: rms error {np.sqrt(np.mean(np.square(millimetres))):.2f} mm of path")


def _bulged_scan(number: int, rng: np.random.Generator) -> Capture:
    names = ("llama", "knot", "hammer", "chair")
    spec = SceneSpec(
        figure=FigureSpec(
            name=names[number // DRAWS_PER_SCAN % len(names)],
            height_m=0.07,
            turn_deg=float(rng.uniform(0.0, 360.0)),
        ),
        walls=(Wall(size_m=COVERAGE_BOX_M, thickness_m=0.004, permittivity=1.6),),
        scan=ScanSpec(n_poses=12, spacing_m=0.006, aperture_m=(0.12, 0.14)),
        numerics=NumericsSpec(wall_patch_m=0.01, antenna_block_m=0.07),
        world=WorldSpec(wall_bulge_m=float(rng.uniform(0.0, 0.002))),
    )
    return simulate(spec, seed=number)[0]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--coverage", type=int, default=200, help="number of scans")
    coverage(parser.parse_args().coverage)
