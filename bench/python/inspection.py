"""What `geraf2 inspect` finds of parts whose position and shape are known.

    python bench/python/inspection.py --out out/inspection [--placements 20] [--preset best]

Six parts of 50 to 70 mm in cartons of 14 cm, turned by any angle about the vertical, tilted by up
to 12 degrees and shifted by up to 10 mm; a bracket with and without the head of its screw (8 mm);
three parts of which one may be missing. `--parts development` takes four other parts: constants are
set on these. Each is simulated, reconstructed, inspected. Captures and runs are kept in `--out` and
used again, so that a stopped script continues where it was; `--cached` counts what is there, makes
nothing new. The inspection is always new. Shares come with their Wilson intervals (95 %).
"""

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation
from skimage.measure import marching_cubes

import geraf2
from geraf2.geometry.transforms import apply_rigid, rigid
from geraf2.io.mesh import TriangleMesh, read_mesh, write_mesh
from geraf2.simulation.spec import FigureSpec, NumericsSpec, ScanSpec, SceneSpec

BOX_M = (0.14, 0.14, 0.14)
_HALF_M, _STEP_M = 0.048, 0.0008
Distance = Callable[[np.ndarray], np.ndarray]


def block(center, half, r=0.0015) -> Distance:
    """Signed distance to a block with rounded edges [m]."""

    def distance(p):
        q = np.abs(p - np.asarray(center)) - (np.asarray(half) - r)
        return np.linalg.norm(np.maximum(q, 0), axis=-1) + np.minimum(q.max(-1), 0) - r

    return distance


def cylinder(center, axis, radius, half, r=0.0012) -> Distance:
    """Signed distance to a cylinder along an axis, with rounded edges [m]."""

    def distance(p):
        off = p - np.asarray(center)
        across = np.linalg.norm(np.delete(off, axis, -1), axis=-1) - (radius - r)
        q = np.stack([np.abs(off[..., axis]) - (half - r), across], -1)
        return np.linalg.norm(np.maximum(q, 0), axis=-1) + np.minimum(q.max(-1), 0) - r

    return distance


BRACKET = (
    block((0, 0, -0.025), (0.03, 0.025, 0.005)),
    block((-0.025, 0, 0.005), (0.005, 0.025, 0.035)),
)
HEAD = cylinder((-0.017, 0, 0.02), 0, 0.004, 0.005, 0.0008)
PARTS: dict[str, tuple[Distance, ...]] = {
    "bracket": (*BRACKET, HEAD),
    "tee": (block((0, 0, 0.02), (0.035, 0.01, 0.01)), block((0, 0, -0.01), (0.01, 0.01, 0.03))),
    "shaft": (cylinder((0, 0, 0), 2, 0.010, 0.04), cylinder((0, 0, -0.015), 2, 0.022, 0.008)),
    "channel": (
        block((0, 0, -0.02), (0.035, 0.022, 0.005)),
        block((0, 0.018, 0), (0.035, 0.004, 0.025)),
        block((0, -0.018, 0), (0.035, 0.004, 0.025)),
    ),
    "knob": (block((0, 0, -0.01), (0.03, 0.02, 0.02)), cylinder((0.01, 0, 0.02), 2, 0.009, 0.015)),
    "ell": (
        block((0, 0, -0.025), (0.03, 0.0125, 0.01)),
        block((-0.02, 0, 0.005), (0.01, 0.0125, 0.035)),
    ),
}
DEVELOPMENT: dict[str, tuple[Distance, ...]] = {
    "step": (
        block((0, 0, -0.018), (0.032, 0.018, 0.008)),
        block((-0.014, 0, 0.006), (0.018, 0.018, 0.016)),
    ),
    "peg": (
        block((-0.018, 0, 0), (0.008, 0.024, 0.03)),
        cylinder((0.01, 0.004, 0.008), 0, 0.011, 0.022),
    ),
    "fork": (
        block((0, 0, -0.02), (0.026, 0.012, 0.008)),
        block((-0.02, 0, 0.01), (0.006, 0.012, 0.026)),
        block((0.02, 0, 0.004), (0.006, 0.012, 0.02)),
    ),
    "slab": (
        block((0, 0, 0), (0.036, 0.009, 0.024)),
        block((0.012, 0.015, -0.006), (0.012, 0.009, 0.012)),
    ),
}
STUD = cylinder((0.008, 0, 0.006), 0, 0.004, 0.005, 0.0008)
FIRST_DEVELOPMENT = 300
TURNS = {"tee": 2, "channel": 2, "shaft": 360}
"""Turns about z that bring a part onto itself: so many make a whole one."""
TRIO = {
    "left": (cylinder((-0.032, 0, 0), 2, 0.012, 0.025),),
    "middle": (block((0, 0, 0), (0.01, 0.014, 0.03)),),
    "right": (cylinder((0.032, 0, -0.005), 2, 0.010, 0.02),),
}
HEADS = {
    "table": ("bracket", BRACKET, HEAD, (-0.015, 0, 0.02), 100),
    "development": ("step with stud", DEVELOPMENT["step"], STUD, (0.009, 0, 0.006), 400),
}
"""Name, parts without and with what may miss, where that is [m], first number of a placement."""


def surface(*distances: Distance) -> TriangleMesh:
    """Closed mesh of the union."""
    at = np.arange(-_HALF_M, _HALF_M, _STEP_M)
    positions = np.stack(np.meshgrid(at, at, at, indexing="ij"), -1)
    values = np.minimum.reduce([d(positions) for d in distances]).astype(np.float32)
    vertices, faces, _, _ = marching_cubes(
        values, 0.0, gradient_direction="descent", allow_degenerate=False
    )
    return TriangleMesh(vertices=vertices * _STEP_M - _HALF_M, faces=faces.astype(np.int64))


@dataclass(frozen=True)
class Case:
    name: str
    number: int
    parts: tuple[Distance, ...]

    @property
    def pose(self) -> np.ndarray:
        rng = np.random.default_rng(self.number)
        turn = Rotation.from_rotvec([0, 0, rng.uniform(-np.pi, np.pi)])
        tilt = Rotation.from_rotvec([*rng.uniform(-0.2, 0.2, 2), 0.0])
        return rigid((turn * tilt).as_matrix(), rng.uniform(-0.01, 0.01, 3))

    def run(self, options: argparse.Namespace) -> Path | None:
        """Folder of its run; None where nothing is to be made."""
        folder = options.out / f"{self.name.replace(' ', '-')}_{self.number}"

        def capture() -> geraf2.Capture:
            mesh = surface(*self.parts)
            placed = TriangleMesh(vertices=apply_rigid(self.pose, mesh.vertices), faces=mesh.faces)
            write_mesh(placed, folder / "truth.ply")
            low, high = placed.vertices.min(axis=0), placed.vertices.max(axis=0)
            spec = SceneSpec(
                figure=FigureSpec(
                    mesh=str(folder / "truth.ply"),
                    height_m=float(high[2] - low[2]),
                    center_m=tuple(float(v) for v in 0.5 * (low + high)),
                ),
                walls=(geraf2.Wall(size_m=BOX_M, thickness_m=0.004, permittivity=1.6),),
                scan=ScanSpec(
                    n_poses=options.planes, spacing_m=options.spacing_m, aperture_m=(0.10, 0.14)
                ),
                numerics=NumericsSpec(wall_patch_m=0.01, antenna_block_m=0.07),
            )
            return geraf2.simulate(spec, seed=self.number)[0]

        return kept_run(folder, capture, BOX_M, options, name=f"run-{options.preset}")


def kept_run(
    folder: Path,
    capture: Callable[[], geraf2.Capture],
    box_m: tuple[float, float, float],
    options: argparse.Namespace,
    *,
    name: str = "run",
) -> Path | None:
    """Run of a scene, both made where they are not there; None where nothing is to be made.

    options: preset, and cached. box_m: outer sides.
    """
    run, scene = folder / name, folder / "scene"
    if (run / "mesh_content.ply").is_file():
        return run
    if options.cached:
        return None
    folder.mkdir(parents=True, exist_ok=True)
    if not (scene / "scene.toml").is_file():
        geraf2.save_capture(capture(), scene)
    geraf2.reconstruct(scene, box_m, options.preset, run, overwrite=True)
    return run


def wilson(n_yes: int, n: int, z: float = 1.96) -> tuple[float, float]:
    """Limits of a share of which n_yes of n were seen (Wilson, 1927)."""
    share, spread = n_yes / n, z * z / n
    middle = (share + 0.5 * spread) / (1.0 + spread)
    half = z * np.sqrt(share * (1.0 - share) / n + 0.25 * spread / n) / (1.0 + spread)
    return max(0.0, middle - half), min(1.0, middle + half)


def print_share(made: list[bool], what: str) -> None:
    named = "none was run"
    if made:
        low, high = (100.0 * limit for limit in wilson(sum(made), len(made)))
        named = f"{sum(made)} of {len(made)}, {100 * np.mean(made):.0f} % ({low:.0f} to {high:.0f})"
    print(f"{what:<52} {named}", flush=True)


def pose_errors(
    found, true: np.ndarray, name: str, middle: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Difference of the middle (3,) [m], and the turn less the part's symmetries (3,) [rad]."""
    steps = np.arange(TURNS.get(name, 1)) * 2 * np.pi / TURNS.get(name, 1)
    turns = Rotation.from_rotvec(steps[:, None] * [0, 0, 1.0]).as_matrix()
    off = Rotation.from_matrix(found.pose[:3, :3] @ turns @ true[:3, :3].T).as_rotvec()
    least = off[np.argmin(np.linalg.norm(off, axis=1))]
    return apply_rigid(found.pose, middle) - apply_rigid(true, middle), least


def single(options: argparse.Namespace) -> None:
    """Pose, right part of several, coverage, and whole parts that fail."""
    parts, first = PARTS, 0
    if options.parts == "development":
        parts, first = DEVELOPMENT, FIRST_DEVELOPMENT
    models = {name: surface(*distances) for name, distances in parts.items()}
    names = list(models)
    near, right, failed, offs, angles, pulls, turns = [], [], [], [], [], [], []
    measured: dict[str, list[bool]] = {"middle": [], "lengths": [], "volume": [], "area": []}
    for number in range(first, first + options.placements):
        name = names[number % len(names)]
        case = Case(name, number, parts[name])
        run = case.run(options)
        if run is None:
            continue
        one = geraf2.inspect(run, [models[name]], write=False)
        several = geraf2.InspectOptions(any_of=True)
        best = geraf2.inspect(run, list(models.values()), options=several, write=False).models
        match = one.models[0].match
        largest = next((r.match.model for r in best if r.match.body in (0, -1)), None)
        taken = "none" if largest is None else names[largest]
        right.append(taken == name)
        failed.append(one.result == "fail")
        _cover(measured, one.parts[0], read_mesh(run.parent / "truth.ply"))
        if match.placement is None:
            near.append(False)
            print(f"  {name} {number}: not found")
            continue
        middle = models[name].vertices.mean(axis=0)
        off, turn = pose_errors(match.placement, case.pose, name, middle)
        offs.append(float(np.linalg.norm(off)))
        angles.append(float(np.rad2deg(np.linalg.norm(turn))))
        near.append(offs[-1] < 1e-3 and angles[-1] < 1.0)
        pulls += list(np.abs(off) / match.placement.position_sigma_m)
        turns += list(np.abs(turn) / match.placement.rotation_sigma_rad)
        print(
            f"  {name} {number}: {1e3 * offs[-1]:.2f} mm, {angles[-1]:.2f} degrees, "
            f"misfit {match.placement.misfit:.2f}, {match.status}, interpreted as {taken}, "
            f"{len(one.parts)} parts, {one.result} {'; '.join(one.failures)}",
            flush=True,
        )
    print_share(near, "pose to 1 mm and 1 degree")
    if offs:
        print(f"  median {1e3 * np.median(offs):.2f} mm, {np.median(angles):.2f} degrees")
    print_share(right, f"right part of {len(names)}")
    print_share(failed, "whole part fails")
    print_share([bool(pull < 1.96) for pull in pulls], "stated 95 % of the pose's middle hold")
    print_share([bool(turn < 1.96) for turn in turns], "stated 95 % of the pose's turn hold")
    for what, held in measured.items():
        print_share(held, f"stated 95 % of {what} hold")


def _cover(measured: dict[str, list[bool]], part, truth: TriangleMesh) -> None:
    from geraf2.apps.inspection.bodies import body_of, measure  # noqa: PLC0415

    exact = measure(body_of(truth))
    for value, sigma, true in zip(part.center_m, part.center_sigma_m, exact.center_m, strict=True):
        measured["middle"].append(abs(value - true) < 1.96 * sigma)
    for axis, length in zip(part.axes, part.dimensions_m, strict=True):
        extent = float(np.ptp(truth.vertices @ np.array(axis)))
        measured["lengths"].append(abs(length.value - extent) < 1.96 * length.sigma)
    for what in ("volume_m3", "area_m2"):
        found, true = getattr(part, what), getattr(exact, what).value
        measured[what.split("_")[0]].append(abs(found.value - true) < 1.96 * found.sigma)


def head(options: argparse.Namespace) -> None:
    """Is the head of the screw there."""
    whole, bare, extra, position, first = HEADS[options.parts]
    model = surface(*bare, extra)
    for name, parts in ((whole, (*bare, extra)), (f"{whole} without head", bare)):
        named, failed = [], []
        for number in range(first, first + options.heads):
            case = Case(name, number, parts)
            run = case.run(options)
            if run is None:
                continue
            answer = geraf2.inspect(run, [model], write=False)
            found = answer.models[0]
            at = apply_rigid(case.pose, np.array(position))
            regions = found.deviation.regions if found.deviation else ()
            here = [
                r
                for r in regions
                if r.what != "too much" and np.linalg.norm(r.center_m - at) < 0.008
            ]
            named.append(bool(here))
            failed.append(answer.result == "fail")
            print(
                f"  {name} {number}: {[(r.what, round(1e6 * r.area_m2)) for r in here]}, "
                f"{answer.result} {'; '.join(answer.failures)}",
                flush=True,
            )
        print_share(
            named, "head reported as missing" + (", though it is there" if name == whole else "")
        )
        print_share(failed, f"{name} fails")


def trio(options: argparse.Namespace) -> None:
    """Is one of three parts missing."""
    models = [surface(*parts) for parts in TRIO.values()]
    for gone in (None, "right"):
        named, failed = [], []
        for number in range(options.first_trio, options.first_trio + options.trios):
            parts = tuple(d for name, ds in TRIO.items() if name != gone for d in ds)
            case = Case("trio" if gone is None else "two of three", number, parts)
            run = case.run(options)
            if run is None:
                continue
            found = geraf2.inspect(run, models, expect=3, write=False)
            states = [report.match.status for report in found.models]
            missing = [status in ("missing", "wrong part") for status in states]
            named.append(any(missing) if gone is None else missing == [n == gone for n in TRIO])
            failed.append(found.result == "fail")
            print(
                f"  {case.name} {number}: {', '.join(states)}; {len(found.parts)} parts, "
                f"{found.result} {'; '.join(found.failures)}",
                flush=True,
            )
        print_share(
            named,
            "one of three reported as missing" if gone is None else "the missing one is named",
        )
        print_share(failed, f"{'all three' if gone is None else 'two of three'} fail")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--out", type=Path, default=Path("out/inspection"))
    parser.add_argument("--placements", type=int, default=20)
    parser.add_argument("--heads", type=int, default=20)
    parser.add_argument("--trios", type=int, default=20)
    parser.add_argument("--first-trio", type=int, default=200)
    parser.add_argument("--planes", type=int, default=36)
    parser.add_argument("--spacing-m", type=float, default=0.004)
    parser.add_argument("--preset", default="fast")
    parser.add_argument("--parts", choices=("table", "development"), default="table")
    parser.add_argument("--cached", action="store_true", help="count only what was run before")
    options = parser.parse_args()
    single(options)
    if options.parts == "table":
        head(options)
        trio(options)


if __name__ == "__main__":
    main()
