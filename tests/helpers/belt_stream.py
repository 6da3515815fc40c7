"""A small belt: one simulated parcel, and streams of its copies."""

from dataclasses import replace
from functools import cache

import numpy as np

from geraf2.io.belt_file import write_belt
from geraf2.io.growing_scene import GrowingScene
from geraf2.scene.store import manifest_of
from geraf2.simulation import simulate
from geraf2.simulation.belt import belt_record
from geraf2.simulation.spec import parse_spec

_ARRAYS = (
    {"side": "left", "row_m": 0.006, "standoff_m": 0.2},
    {"side": "above", "row_m": 0.006, "standoff_m": 0.2},
    {"side": "left", "name": "speed", "station_m": 0.2, "row_m": 0.006, "standoff_m": 0.2},
)
PITCH_M = 0.6


@cache
def small_parcel(**changes):
    """Recorded capture and its belt."""
    belt = {"travel_m": 0.4, "frame_m": 0.004, "segment_m": 0.2, "arrays": _ARRAYS, **changes}
    spec = parse_spec(
        {
            "figure": {"name": "ball", "height_m": 0.06},
            "walls": [{"size_m": (0.16, 0.16, 0.16)}],
            "numerics": {"max_facet_edge_m": 0.0012, "wall_patch_m": 0.01},
            "disturbance": {"far_walls": False},
            "belt": belt,
        }
    )
    capture, _ = simulate(spec, seed=0, num_threads=1)
    return capture, belt_record(spec.belt)


def stream_planes(n_parcels, **changes):
    """Planes of parcels one after the other, in the order of time."""
    capture, _ = small_parcel(**changes)
    planes = []
    for k in range(n_parcels):
        rng = np.random.default_rng(k)
        for number, pose in enumerate(capture.poses):
            array = pose.name.rpartition("/")[0]
            noise = 1e-3 * rng.normal(size=(*pose.signal.shape, 2)) @ [1.0, 1j]
            moved = pose.moved(np.array([-k * PITCH_M, 0.0, 0.0]))
            signal = (pose.signal + noise).astype(np.complex64)
            name = f"{array}/{k * len(capture.poses) + number}"
            planes.append(replace(moved, name=name, signal=signal))
    return planes


def write_stream(path, planes, **changes):
    """Write planes as a stream."""
    capture, record = small_parcel(**changes)
    about = replace(capture, poses=(), provenance={"n_planes": str(len(planes))})
    scene = GrowingScene(path, manifest_of(about))
    for number, pose in enumerate(planes):
        scene.append(pose)
        if not number:
            write_belt(path, record)
    return path
