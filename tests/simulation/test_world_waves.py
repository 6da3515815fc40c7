"""Effects of waves, second bounce and dielectric objects on a whole small capture."""

from dataclasses import replace

import numpy as np
import pytest

import geraf2
from geraf2.errors import UserError
from geraf2.simulation import WorldSpec, simulate
from geraf2.simulation.dielectric import face_reflection


def small_spec(**world):
    spec = geraf2.examples.small_scene()
    return replace(
        spec,
        figure=replace(spec.figure, name="chair", height_m=0.05),
        scan=replace(spec.scan, n_poses=1, spacing_m=0.01),
        disturbance=replace(spec.disturbance, snr_db=np.inf),
        numerics=replace(spec.numerics, antenna_block_m=0.07),
        world=WorldSpec(**world),
    )


def signal(**world):
    return simulate(small_spec(**world), seed=1, num_threads=2)[0].poses[0].signal


@pytest.fixture(scope="module")
def ideal():
    return signal()


@pytest.mark.parametrize("effect", ["wall_waves", "multipath", "second_bounce"])
def test_effect_changes_the_capture_and_threads_do_not(ideal, effect):
    got = signal(**{effect: True})
    change = np.linalg.norm(got - ideal) / np.linalg.norm(ideal)
    assert 0.002 < change < 0.8
    again = simulate(small_spec(**{effect: True}), seed=1, num_threads=1)[0].poses[0].signal
    assert (got == again).all()


def test_a_shell_shows_what_it_holds():
    spec = replace(small_spec(figure_permittivity=2.7, figure_shell_m=0.0008), walls=())
    spec = replace(spec, figure=replace(spec.figure, name="ball"))
    # Beside the line to the middle, so that the far side is seen, too.
    inside = replace(spec.figure, height_m=0.012, center_m=(0.0, 0.011, 0.0))
    alone, shell, full = (
        simulate(one, seed=1)
        for one in (
            replace(spec, figure=inside, world=WorldSpec()),
            spec,
            replace(spec, inside=inside),
        )
    )
    assert len(full[1].vertices) == len(shell[1].vertices) + len(alone[1].vertices)
    # Captures are of unit power: that of the full one is a sum of both others, but for shadows.
    both = np.stack([one[0].poses[0].signal.ravel() for one in (alone, shell)], axis=1)
    full_signal = full[0].poses[0].signal.ravel()
    found, *_ = np.linalg.lstsq(both, full_signal, rcond=None)
    assert np.linalg.norm(both @ found - full_signal) < 0.35 * np.linalg.norm(full_signal)
    assert (np.abs(found) > 0.2).all()
    with pytest.raises(UserError, match="inside"):
        simulate(replace(spec, inside=replace(inside, height_m=0.06)), seed=1)


def test_a_dielectric_figure_echoes_less_and_from_its_back_face_too():
    spec = small_spec()
    spec = replace(spec, walls=())
    metal, plastic, lossy = (
        simulate(replace(spec, world=WorldSpec(**world)), seed=1)[0].poses[0].signal
        for world in (
            {},
            {"figure_permittivity": 3.45},
            {"figure_permittivity": 3.45, "figure_loss_tangent": 2.0},
        )
    )
    assert face_reflection(np.ones(1), 3.45)[0] == pytest.approx(-0.3, abs=1e-4)
    # Nothing comes back through so much loss, and captures are of unit power: metal's is left.
    assert np.linalg.norm(lossy - metal) < 1e-3 * np.linalg.norm(metal)
    assert np.linalg.norm(plastic - metal) > 0.1 * np.linalg.norm(metal)
