"""Scans of ordinary objects: sixteen shapes in cartons, each scanned in eight ways.

Half of the objects are there to estimate constants, the other half to decide. A seed names the
object and the way; object, carton and antennas are the same in all eight ways, so that ways can be
compared in pairs, too.
"""

from dataclasses import replace
from importlib.resources import files

import numpy as np

from geraf2.errors import UserError
from geraf2.geometry.transforms import triple
from geraf2.io.mesh import TriangleMesh
from geraf2.io.toml import read_table
from geraf2.simulation.population import (
    RADARS,
    WITHOUT_WAVES,
    DrawnScene,
    draw_box,
    simulation_seconds,
)
from geraf2.simulation.population_settings import Population
from geraf2.simulation.solids import build_solid
from geraf2.simulation.spec import (
    DisturbanceSpec,
    FigureSpec,
    RingSpec,
    ScanSpec,
    SceneSpec,
    UpAxis,
)
from geraf2.simulation.world import WorldSpec

OBJECTS = tuple(read_table(files("geraf2.simulation") / "ordinary.toml"))
"""Names of the objects: first those to estimate with, then those to decide."""
N_EACH = len(OBJECTS) // 2
"""Objects of each half."""
N_WAYS = 8
"""Ways to scan an object: every combination of errors of the world, echoes of the far walls, and
raised planes."""
DECIDING_SEED = 1000
"""First seed of the half that decides."""
ORDINARY_VERSION = 1
"""Raised when a seed gives another object or another scan."""

_CARTONS = Population(box_side_m=(0.10, 0.18), budget_s=25.0)
"""Cartons are the population's, but fit: sides above 0.18 m are as the object needs."""
_LARGEST_M = (0.08, 0.13)
"""Largest extent of an object as it is turned [m]."""
_LYING = ("spanner", "pliers")
"""Objects that lie on a side."""
_RING = ScanSpec(n_poses=18, spacing_m=0.004, aperture_m=(0.12, 0.18))
_RAISED = replace(
    _RING,
    n_poses=10,
    rings=(RingSpec(n_poses=7, elevation_deg=40.0), RingSpec(elevation_deg=90.0)),
)
"""As many planes: around the box, raised, and one above it."""
_MIN_STANDOFF_M, _SNR_DB = 0.35, 20.0


def draw_ordinary(seed: int) -> DrawnScene:
    """Return the ordinary scene of a seed, 0 to 63 to estimate and 1000 to 1063 to decide.

    The last three digits of a seed are the number of the object plus 8 times that of the way, whose
    bits are errors of the world, echoes of the far walls, and raised planes.

    >>> from geraf2.simulation.ordinary import draw_ordinary
    >>> drawn = draw_ordinary(1008)
    >>> drawn.record["object"], drawn.record["scan"], drawn.record["world"]
    ('watering_can', 'one ring', 'plausible')
    """
    half, rest = divmod(seed, DECIDING_SEED)
    way, number = divmod(rest, N_EACH)
    if half > 1 or way >= N_WAYS:
        n = N_WAYS * N_EACH
        raise UserError(
            what="there is no such ordinary scene",
            where="--seeds",
            expected=f"seeds within 0:{n} to estimate or {DECIDING_SEED}:{DECIDING_SEED + n} to "
            "decide",
            got=str(seed),
        )
    has_world, has_flash, is_raised = (bool(way & bit) for bit in (1, 2, 4))
    number += half * N_EACH
    rng = np.random.default_rng(number)
    figure, mesh = _draw_object(rng, OBJECTS[number])
    extents = np.ptp(mesh.vertices, axis=0)
    standing = bool(rng.random() < _CARTONS.standing)
    wall, center = draw_box(rng, _CARTONS, extents, standing=standing)
    clear_m = 0.5 * float(np.linalg.norm(wall.size_m)) + _CARTONS.box_distance_m
    start_deg = rng.uniform(0.0, 360.0)
    spec = SceneSpec(
        figure=replace(figure, center_m=triple(center)),
        walls=(wall,),
        waveform=RADARS["AWR1843"],
        scan=replace(
            _RAISED if is_raised else _RING,
            start_angle_deg=start_deg,
            standoff_m=max(_MIN_STANDOFF_M, clear_m),
        ),
        disturbance=DisturbanceSpec(snr_db=_SNR_DB, far_walls=has_flash),
        world=WorldSpec(preset="plausible", effects=WITHOUT_WAVES) if has_world else WorldSpec(),
    )
    # Smaller planes where the simulation would take too long: as many antennas in every way.
    share = min(1.0, _CARTONS.budget_s / simulation_seconds(spec, mesh))
    width, height = (float(np.sqrt(share)) * side for side in _RING.aperture_m)
    spec = replace(spec, scan=replace(spec.scan, aperture_m=(width, height)))
    record = {
        "seed": seed,
        "object": OBJECTS[number],
        "half": "decide" if half else "estimate",
        "scan": "raised planes" if is_raised else "one ring",
        "far walls": "with echoes" if has_flash else "without",
        "world": spec.world.preset,
        "standing": standing,
        "extents_m": extents.tolist(),
        "box_m": list(wall.size_m),
        "aperture_m": [width, height],
        "standoff_m": spec.scan.standoff_m,
        "estimated_s": simulation_seconds(spec, mesh),
    }
    return DrawnScene(spec=spec, record=record)


def _draw_object(rng: np.random.Generator, name: str) -> tuple[FigureSpec, TriangleMesh]:
    """Object turned about the vertical and of a drawn size, and its mesh about the origin."""
    up: UpAxis = "+x" if name in _LYING else "+z"
    figure = FigureSpec(name=name, up=up, turn_deg=rng.uniform(0.0, 360.0))
    mesh = build_solid(figure)
    scale = rng.uniform(*_LARGEST_M) / float(np.ptp(mesh.vertices, axis=0).max())
    vertices = scale * mesh.vertices
    return replace(figure, height_m=scale * figure.height_m), replace(mesh, vertices=vertices)
