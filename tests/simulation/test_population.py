"""Random objects and scans of the population: closed, reproducible, inside their box."""

import functools

import numpy as np
import pytest
import trimesh

from geraf2.simulation.population import RADARS, draw_scene
from geraf2.simulation.population_settings import POPULATION
from geraf2.simulation.random_objects import random_object

SEEDS = (6, 9)  # one body that stands; two that float


@functools.cache
def thing(seed):
    return random_object(seed)


@functools.cache
def scene(seed):
    return draw_scene(seed)


def as_trimesh(mesh):
    return trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)


@pytest.mark.parametrize("seed", SEEDS)
def test_an_object_is_closed_outward_and_of_as_many_pieces_as_bodies(seed):
    mesh = as_trimesh(thing(seed).mesh)
    assert mesh.is_watertight
    assert mesh.volume > 0
    assert mesh.body_count == len(thing(seed).parts)
    low, high = POPULATION.size_m[mesh.body_count - 1]
    assert low <= thing(seed).extents_m.max() <= high
    assert 0.5 * (mesh.bounds[0] + mesh.bounds[1]) == pytest.approx([0, 0, 0], abs=1e-9)


def test_the_same_seed_gives_the_same_bytes_and_another_another_object():
    again = random_object(6)
    assert again.mesh.vertices.tobytes() == thing(6).mesh.vertices.tobytes()
    assert again.mesh.faces.tobytes() == thing(6).mesh.faces.tobytes()
    first = draw_scene(6)
    assert (first.spec, first.record) == (scene(6).spec, scene(6).record)
    assert thing(9).mesh.vertices.tobytes() != thing(6).mesh.vertices.tobytes()
    assert scene(9).spec != scene(6).spec


@pytest.mark.parametrize("seed", SEEDS)
def test_the_content_lies_in_its_box_and_the_planes_outside(seed):
    spec, record = scene(seed).spec, scene(seed).record
    wall, figure = spec.walls[0], spec.figure
    room = 0.5 * np.asarray(wall.size_m) - wall.thickness_m
    sides = (
        np.asarray(figure.center_m) - 0.5 * thing(seed).extents_m,
        (np.asarray(figure.center_m) + 0.5 * thing(seed).extents_m),
    )
    clearance = np.minimum(sides[0] + room, room - sides[1])
    least = POPULATION.clearance_m[0]
    assert clearance[:2].min() >= least
    assert (room - sides[1])[2] >= least
    gap = (sides[0] + room)[2]
    if thing(seed).standing:
        assert gap == pytest.approx(POPULATION.foot_gap_m)
    else:
        assert gap >= least
    assert spec.scan.standoff_m > 0.5 * np.linalg.norm(wall.size_m)
    assert record["estimated_s"] <= POPULATION.waves_budget_s
    assert spec.waveform == RADARS[record["radar"]]
