"""Reflectivity of returns: closed forms, and sums over surfaces and antennas as slow twins."""

import numpy as np
import pytest
import trimesh

from geraf2.echoes.glints import find_echoes
from geraf2.echoes.reflectivity import (
    Windows,
    crossing_loss,
    db,
    face_reflection,
    mid_wave_number,
    slab_reflection,
    spreading,
    squarely,
    wall_flash,
    window_gain,
)
from geraf2.scene import LosPrior, Wall, Waveform
from geraf2.scene.aperture import Aperture
from geraf2.simulation import FigureSpec, NumericsSpec, ScanSpec, SceneSpec, simulate
from geraf2.simulation.spec import AWR1843

K = 2 * np.pi / 0.0039  # of 77 GHz [rad/m]
BOARD = Wall(size_m=(0.2, 0.2, 0.2), thickness_m=0.004, permittivity=1.6)


def bent(c1, c2):
    """Shape operator of a surface whose normal is x."""
    return np.diag([0.0, c1, c2])[None]


def test_spreading_of_a_plane_and_of_a_sphere():
    """Optics limit of Mie: the cross section pi a^2 is a / (2 R^2) far away."""
    r = np.array([0.4])
    assert spreading(r, bent(0, 0)) == pytest.approx(1 / 0.8)
    a, far = 0.03, np.array([30.0])
    assert spreading(r, bent(1 / a, 1 / a)) == pytest.approx(a / (2 * r * (r + a)))
    cross_section = 4 * np.pi * far**4 * spreading(far, bent(1 / a, 1 / a)) ** 2
    assert cross_section == pytest.approx(np.pi * a**2, rel=3e-3)
    assert np.isnan(spreading(r, bent(-1 / 0.1, 0.0))).all()  # beyond the caustic


@pytest.mark.parametrize(("c1", "c2"), [(1 / 0.03, 1 / 0.05), (1 / 0.02, 0.0), (12.0, -1.0)])
def test_spreading_is_that_of_the_kirchhoff_integral(c1, c2):
    """|s| = lambda / (4 pi) of it, by a sum over a smoothly tapered quadric."""
    r, side, n = 0.3, 0.09, 1201
    y, z = np.meshgrid(*[np.linspace(-side, side, n)] * 2, indexing="ij")
    depth = 0.5 * (c1 * y**2 + c2 * z**2)
    at = np.stack([-depth, y, z])
    there = np.array([r, 0, 0])[:, None, None] - at
    gap = np.linalg.norm(there, axis=0)
    # The area times the cosine is the normal without its length, (1, c1 y, c2 z), along the path.
    facing = (there[0] + c1 * y * there[1] + c2 * z * there[2]) / gap
    taper = np.cos(0.5 * np.pi * y / side) ** 2 * np.cos(0.5 * np.pi * z / side) ** 2
    total = np.sum(taper * facing / gap**2 * np.exp(-2j * K * gap)) * (2 * side / (n - 1)) ** 2
    echo = np.abs(total) / (4 * np.pi)
    assert db(4 * np.pi * echo / 0.0039 / spreading(np.array([r]), bent(c1, c2))) == pytest.approx(
        0.0, abs=0.3
    )


def window(focus_m, side_m=0.08):
    return Windows(np.eye(3)[None], np.full((1, 2), side_m), np.array([focus_m]))


def test_a_window_that_is_focused_on_the_centre_of_curvature_keeps_all():
    r, a = np.array([0.35]), 0.05
    assert window_gain(window(0.40), r, bent(1 / a, 1 / a), K) == pytest.approx(1.0)
    assert window_gain(window(0.40), r, bent(0, 0), K) < 0.5


def test_a_plane_that_faces_across_the_content_has_no_focus():
    prior, axes = LosPrior.from_box((0.2,) * 3), np.eye(3)
    planes = [
        Aperture.from_rectangle(np.array(at), axes, [0.1, 0.1])
        for at in ((0, 0.4, 0), (-0.4, 0, 0))
    ]
    middles = np.array([plane.middle_m for plane in planes])
    windows = Windows.of(planes, np.arange(2), middles, prior, 0.08)
    assert np.isfinite(window_gain(windows, np.full(2, 0.3), np.zeros((2, 3, 3)), K)).all()
    assert squarely(windows, np.tile(axes[0], (2, 1))).tolist() == [False, True]


def test_fresnel_and_the_slab():
    assert db(abs(face_reflection(2.7))) == pytest.approx(-12.3, abs=0.1)
    assert crossing_loss([BOARD, BOARD]) == pytest.approx((1 - face_reflection(1.6) ** 2) ** 4)
    index, f = 1.6**0.5, 78e9
    half_wave = 299792458.0 / f / (2 * index)
    for share, wanted in ((1.0, 0.0), (0.5, (1.6 - 1) / (1.6 + 1))):
        wall = Wall(size_m=(0.2,) * 3, thickness_m=share * half_wave, permittivity=1.6)
        assert np.abs(slab_reflection(wall, np.array([f]))) == pytest.approx(wanted, abs=1e-9)
    narrow = Waveform(
        start_frequency_hz=f, chirp_slope_hz_per_s=1e9, sample_rate_hz=1e6, n_samples=32
    )
    quarter = Wall(size_m=(0.2,) * 3, thickness_m=0.5 * half_wave, permittivity=1.6)
    assert wall_flash(quarter, narrow) == pytest.approx(0.6 / 2.6, rel=1e-3)
    thin = wall_flash(BOARD, AWR1843, 1e-3)
    assert thin < 0.01 < wall_flash(BOARD, AWR1843)


def test_a_ball_in_a_carton_has_its_reflectivity(tmp_path):
    """The simulator's scale is that of all echoes: only the wall's flash gives it."""
    a, reflectivity = 0.03, 0.5
    trimesh.creation.icosphere(4, a).export(tmp_path / "ball.ply")
    spec = SceneSpec(
        figure=FigureSpec(
            mesh=str(tmp_path / "ball.ply"), height_m=2 * a, reflectivity=reflectivity
        ),
        walls=(BOARD,),
        scan=ScanSpec(n_poses=1, spacing_m=0.004, aperture_m=(0.12, 0.12)),
        numerics=NumericsSpec(antenna_block_m=0.04),
    )
    capture, _ = simulate(spec, seed=0)
    prior = LosPrior.from_box((0.2, 0.2, 0.2), walls=(BOARD,))
    found = find_echoes(capture, prior)
    glints, metal = found.glints, found.metal
    assert metal is not None
    assert metal.n_flashes >= 8
    apertures = [Aperture.from_pose(pose) for pose in capture.poses]
    met = apertures[0].mirror(glints.positions, glints.normals)
    bend = (np.eye(3) - glints.normals[:, :, None] * glints.normals[:, None, :]) / a
    seen = Windows.of(apertures, glints.poses, met.positions_m, prior, 0.08)
    amplitude = spreading(met.distances_m, bend) * window_gain(
        seen, met.distances_m, bend, mid_wave_number(capture.waveform)
    )
    levels = db(glints.strengths / (amplitude * metal.strength_m * crossing_loss([BOARD])))
    on_ball = np.abs(np.linalg.norm(glints.positions, axis=1) - a) < 0.003
    assert on_ball.sum() >= 4
    assert np.median(levels[on_ball]) == pytest.approx(db(reflectivity), abs=1.0)


def test_without_walls_there_is_no_scale():
    from geraf2 import examples  # noqa: PLC0415 - simulates

    capture, _ = examples.small_capture()
    bare = type(capture)(poses=capture.poses, waveform=capture.waveform)
    assert find_echoes(bare, LosPrior.from_box(examples.BOX_M)).metal is None
