"""Random scans of the population: object, box, planes, radar and world of one seed."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from geraf2._types import Floats
from geraf2.geometry.transforms import triple
from geraf2.geometry.triangles import face_areas
from geraf2.io.mesh import TriangleMesh
from geraf2.scene import Wall, Waveform
from geraf2.scene.plan import rows_columns
from geraf2.simulation.population_settings import POPULATION, Population
from geraf2.simulation.random_objects import RandomObject, choose, random_object
from geraf2.simulation.spec import (
    AWR1843,
    DisturbanceSpec,
    FigureSpec,
    RingSpec,
    ScanSpec,
    SceneSpec,
)
from geraf2.simulation.world import EFFECTS, WorldSpec

RADARS: dict[str, Waveform] = {
    "AWR1843": AWR1843,
    "64 samples": replace(AWR1843, n_samples=64, sample_rate_hz=1250e3),
    "4 GHz": replace(
        AWR1843, start_frequency_hz=77e9, chirp_slope_hz_per_s=80e12, sample_rate_hz=640e3
    ),
    "60 GHz": replace(AWR1843, start_frequency_hz=60.0e9),
}
"""Chirps by name."""
_PLASTIC = "dielectric"
WITHOUT_WAVES = tuple(e for e in EFFECTS if e not in (_PLASTIC, "waves", "second_bounce"))
"""Effects of the world but for those whose simulation is slow, and for plastic."""
# CPU seconds of the simulator, measured on one thread: for each pair of an antenna sample and an
# element of a surface; for rays in plastic, or that touch the object twice, a pair and a sample;
# for walls as waves an antenna and square metre of walls.
_PAIR_S, _RAY_PAIR_S, _RAY_SAMPLE_S, _WAVE_S = 0.45e-9, 0.6e-9, 10e-6, 28e-3
_MIN_PLANES, _FEW_PLANES, _MIN_APERTURE_M, _COARSEST_M = 6, 8, 0.06, 0.005


@dataclass(frozen=True, kw_only=True, eq=False)
class DrawnScene:
    """Spec of a seed, and the record of what was drawn."""

    spec: SceneSpec
    """For the simulator."""
    record: Mapping[str, Any]
    """What was drawn, plain numbers and words for JSON; lengths in metres."""


def draw_scene(seed: int, population: Population = POPULATION) -> DrawnScene:
    """Draw object, box, planes, radar and world of a seed.

    Antennas, then planes, are reduced where the simulation would take longer than the budget.

    seed: of all draws; the object of the spec is `random-SEED`, which only the default population
    makes.
    population: the distributions.

    >>> from geraf2.simulation.population import draw_scene
    >>> draw_scene(0).spec.figure.name
    'random-0'
    """
    rng = np.random.default_rng(seed)
    thing = random_object(rng, population)
    world = _world(rng, population, thing)
    wall, center = draw_box(rng, population, thing.extents_m, standing=thing.standing)
    radar = choose(rng, population.radar)
    scan = _scan(rng, population, wall)
    has_clutter = rng.random() < population.clutter
    clutter = rng.uniform(*population.clutter_share)
    disturbance = DisturbanceSpec(
        snr_db=rng.uniform(*population.snr_db),
        scatterer_energy_fraction=clutter if has_clutter else 0.0,
    )
    spec = SceneSpec(
        figure=FigureSpec(
            name=f"random-{seed}", height_m=float(thing.extents_m[2]), center_m=triple(center)
        ),
        walls=(wall,),
        waveform=RADARS[radar],
        scan=scan,
        disturbance=disturbance,
        world=world,
    )
    budget_s = population.waves_budget_s if world.wall_waves else population.budget_s
    spec = limit_to_budget(spec, thing.mesh, budget_s)
    record = {
        "seed": seed,
        "parts": [list(kinds) for kinds in thing.parts],
        "n_bodies": len(thing.parts),
        "standing": thing.standing,
        "material": "plastic" if thing.permittivity else "metal",
        "permittivity": thing.permittivity,
        "extents_m": thing.extents_m.tolist(),
        "box_m": list(wall.size_m),
        "radar": radar,
        "n_planes": spec.scan.n_planes,
        "raised_deg": [ring.elevation_deg for ring in spec.scan.rings],
        "spacing_m": spec.scan.spacing_m,
        "aperture_m": list(spec.scan.aperture_m),
        "standoff_m": spec.scan.standoff_m,
        "snr_db": disturbance.snr_db,
        "clutter": disturbance.scatterer_energy_fraction,
        "world": world.preset,
        "waves": world.wall_waves,
        "estimated_s": simulation_seconds(spec, thing.mesh),
    }
    return DrawnScene(spec=spec, record=record)


def draw_box(
    rng: np.random.Generator, population: Population, extents_m: Floats, *, standing: bool
) -> tuple[Wall, Floats]:
    """Box that holds an object with clearance, and the middle of the object in it, (3,) [m].

    extents_m: sides of the object, (3,) [m]. standing: whether it stands on the floor.
    """
    low, high = population.box_side_m
    thickness = rng.uniform(*population.wall_thickness_m)
    clearance = rng.uniform(*population.clearance_m)
    # Half of the diagonal: a box that is turned by some degrees still holds the object.
    around = np.linalg.norm(extents_m[:2]) * np.sin(np.deg2rad(3.5))
    needed = extents_m + 2.0 * (thickness + clearance) + [around, around, 0.0]
    least = np.maximum(low, needed)
    size = least + rng.uniform(0.0, 1.0, 3) * np.maximum(high - least, 0.0)
    room = np.maximum(0.5 * (size - needed), 0.0)
    center = rng.uniform(-1.0, 1.0, 3) * room
    if standing:
        floor = -0.5 * size[2] + thickness + population.foot_gap_m
        center[2] = floor + 0.5 * extents_m[2]
    wall = Wall(
        size_m=triple(size),
        thickness_m=thickness,
        permittivity=rng.uniform(*population.wall_permittivity),
        center_m=(0.0, 0.0, 0.0),
    )
    return wall, center


def _scan(rng: np.random.Generator, population: Population, wall: Wall) -> ScanSpec:
    fewest, most = population.n_planes
    n_planes = round(float(np.exp(rng.uniform(np.log(fewest), np.log(most)))))
    kind = choose(rng, population.scan_kind)
    n_raised = int(rng.integers(*population.n_raised, endpoint=True))
    n_second = {"ring": 0, "raised": min(n_raised, n_planes - 4), "two rings": n_planes // 2}[kind]
    elevation_deg = rng.uniform(*population.raised_deg)
    start_deg, second_deg = rng.uniform(0.0, 360.0, 2)
    has_top = rng.random() < population.top_plane and kind == "raised"
    rings, n_raised = [], n_second - has_top
    if n_raised > 0:
        rings.append(
            RingSpec(n_poses=n_raised, elevation_deg=elevation_deg, start_angle_deg=second_deg)
        )
    if has_top:
        rings.append(RingSpec(n_poses=1, elevation_deg=90.0))
    clear = 0.5 * float(np.linalg.norm(wall.size_m)) + population.box_distance_m
    return ScanSpec(
        n_poses=n_planes - n_second,
        start_angle_deg=start_deg,
        aperture_m=(
            rng.uniform(*population.aperture_width_m),
            rng.uniform(*population.aperture_height_m),
        ),
        spacing_m=population.spacing_m[int(rng.integers(len(population.spacing_m)))],
        standoff_m=max(clear, rng.uniform(*population.standoff_m)),
        rings=tuple(rings),
    )


def _world(rng: np.random.Generator, population: Population, thing: RandomObject) -> WorldSpec:
    preset: Any = choose(rng, population.world)
    has_waves = bool(rng.random() < population.waves)
    world = WorldSpec(wall_waves=has_waves, multipath=has_waves, second_bounce=has_waves)
    if preset != "none":
        with_waves = tuple(e for e in EFFECTS if e != _PLASTIC)
        world = WorldSpec(preset=preset, effects=with_waves if has_waves else WITHOUT_WAVES)
    return replace(
        world, figure_permittivity=thing.permittivity, figure_loss_tangent=thing.loss_tangent
    )


def simulation_seconds(spec: SceneSpec, mesh: TriangleMesh) -> float:
    """Estimate of the CPU time of a simulation of this object [s], from measured rates."""
    edge, patch = spec.numerics.max_facet_edge_m, spec.numerics.wall_patch_m
    n_facets = float(face_areas(mesh.corners).sum()) / (0.3 * edge**2)
    x, y, z = spec.walls[0].size_m
    n_patches = 4.0 * (x * y + y * z + z * x) / patch**2
    n_samples, of_sample = spec.waveform.n_samples, _PAIR_S * (n_facets + n_patches)
    if spec.world.second_bounce or spec.world.figure_permittivity:
        of_sample += _RAY_SAMPLE_S + _RAY_PAIR_S * n_facets
    of_antenna = n_samples * of_sample
    if spec.world.wall_waves:
        of_antenna += _WAVE_S * 2.0 * (x * y + y * z + z * x)
    rows, columns = rows_columns(spec.scan.aperture_m, spec.scan.spacing_m)
    return rows * columns * spec.scan.n_planes * of_antenna


def limit_to_budget(spec: SceneSpec, mesh: TriangleMesh, budget_s: float) -> SceneSpec:
    """Spec that does not exceed the budget: fewer and smaller planes, then a coarser raster.

    The raster gets coarser only where few planes are left: it decides where grating lobes are.
    """
    while simulation_seconds(spec, mesh) > budget_s:
        scan = spec.scan
        if scan.n_planes <= _FEW_PLANES and scan.spacing_m < _COARSEST_M:
            smaller = replace(scan, spacing_m=min(_COARSEST_M, scan.spacing_m + 0.001))
        else:
            width, height = (max(_MIN_APERTURE_M, 0.97 * side) for side in scan.aperture_m)
            smaller = replace(_drop_plane(scan), aperture_m=(width, height))
        if smaller == scan:
            break
        spec = replace(spec, scan=smaller)
    return spec


def _drop_plane(scan: ScanSpec) -> ScanSpec:
    """Scan with one plane less, of the larger ring; with the fewest planes the same."""
    if scan.n_planes <= _MIN_PLANES:
        return scan
    if scan.rings and scan.rings[0].n_poses > max(1, scan.n_poses):
        first = replace(scan.rings[0], n_poses=scan.rings[0].n_poses - 1)
        return replace(scan, rings=(first, *scan.rings[1:]))
    return replace(scan, n_poses=scan.n_poses - 1)
