from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from geraf2.calibration.wall_alignment import (
    AlignmentConfig,
    WallProblem,
    find_wall_offset,
)
from geraf2.constants import SPEED_OF_LIGHT_M_PER_S
from geraf2.echoes.flashes import WallMiddles, loss_shift
from geraf2.imaging.peaks import KeptPeaks
from geraf2.scene import Wall
from helpers.carton import PRIOR, aligned, bulged, carton_capture, with_bias
from helpers.synthetic import waveform_of


@pytest.fixture(scope="module")
def capture():
    return carton_capture()


@pytest.mark.parametrize("recorded", [0.0, 0.15, 0.4])
def test_the_delay_moves_the_walls_onto_the_prior(capture, recorded):
    wide = AlignmentConfig(delay_search_m=(-0.3, 1.0))
    found = aligned(with_bias(capture, recorded), PRIOR, wide)
    assert found.delay_m == pytest.approx(0.15 - recorded, abs=1e-3)
    assert abs(found.delay_m - 0.15 + recorded) < 2.0 * found.delay_sigma_m
    assert found.rms_m[1] < 8e-4


def test_walls_echo_from_their_optical_middle(capture):
    board = Wall(size_m=(0.2, 0.2, 0.2), thickness_m=0.00394, permittivity=1.44)
    middles = WallMiddles.of((board,), capture.waveform)
    near, far = middles.depths_m
    shift = np.mean([loss_shift(board, capture.waveform, loss_db) for loss_db in (0.0, 0.45, 0.9)])
    optical = 1.2 * board.thickness_m
    assert near == pytest.approx(0.5 * optical + shift)
    assert far == pytest.approx(1.5 * optical - 2.0 * board.thickness_m + shift)
    found = aligned(capture, replace(PRIOR, walls=(board,)))
    # Half of the two middles' sum, for the capture's walls have none.
    assert found.delay_m == pytest.approx(-(near + far), abs=8e-4)
    unknown = aligned(replace(capture, walls=()), replace(PRIOR, walls=()))
    assert unknown.delay_sigma_m > 1.2 * found.delay_sigma_m


@pytest.mark.parametrize("loss_db", [0.0, 0.45, 0.9])
def test_the_echo_of_faces_that_cancel_is_found_a_range_cell_away(loss_db):
    """Twin: a zero-padded Fourier transform. Two wavelengths of optical path: seed 24."""
    waveform = replace(waveform_of(), start_frequency_hz=60e9)
    wall = Wall(size_m=(0.25, 0.18, 0.17), thickness_m=0.0038605, permittivity=1.57572)
    middle = np.sqrt(wall.permittivity) * wall.thickness_m  # of both faces, two-way
    turns, index = waveform.frequencies_hz / SPEED_OF_LIGHT_M_PER_S, np.sqrt(wall.permittivity)
    second = (1.0 - ((index - 1.0) / (index + 1.0)) ** 2) * 10.0 ** (-0.1 * loss_db)
    echo = 1.0 - second * np.exp(-4j * np.pi * turns * middle)
    # The origin is half a period before the middle, so that nothing wraps around.
    period = 1.0 / (turns[1] - turns[0])
    echo = echo * np.exp(2j * np.pi * turns * (middle - 0.5 * period))
    spectrum = np.abs(np.fft.ifft(np.hanning(34)[1:-1] * echo, 2**16))
    peak = 0.5 * (spectrum.argmax() / 2**16 - 0.5) * period
    found = loss_shift(wall, waveform, loss_db)
    assert found == pytest.approx(peak, abs=1e-4)
    assert -0.04 < found < -0.015


def test_unknowns_that_vertical_walls_do_not_show_keep_their_uncertainty(capture):
    found = aligned(capture, PRIOR, AlignmentConfig(translation_sigma_m=0.02))
    assert found.translation_sigma_m[2] == pytest.approx(0.02, rel=1e-3)
    assert (found.translation_sigma_m[:2] < 0.002).all()


def test_a_shifted_turntable_axis_is_a_wrong_delay(capture):
    """Nearer by 2 mm for all poses is a path shorter by 4 mm."""
    wrong = carton_capture(errors=lambda _, axes, n: 0.002 * axes[0])
    assert aligned(wrong, PRIOR).delay_m == pytest.approx(-0.004, abs=1e-3)
    assert aligned(wrong, PRIOR, AlignmentConfig(keep_delay=True)).delay_m == 0.0


def test_a_far_wall_alone_is_never_interpreted_as_a_near_one():
    rng = np.random.default_rng(0)

    def around(offset_m, n, magnitude):
        return offset_m + 0.001 * rng.normal(size=n), np.full(n, magnitude)

    def joined(*kinds):
        return tuple(np.concatenate(parts) for parts in zip(*kinds, strict=True))

    # Four times as many echoes, six times as strong, a box behind the near wall.
    clutter = rng.uniform(-0.3, 0.6, 40), np.full(40, 0.5)
    near = joined(around(0.1, 60, 1.0), around(0.3, 240, 6.0), clutter)
    far = joined(around(0.1, 240, 6.0), around(-0.1, 60, 1.0), clutter)
    assert find_wall_offset(near, far, (-0.3, 0.5)) == pytest.approx(0.1, abs=1e-3)


@pytest.mark.parametrize("height_m", [0.003, -0.003])
def test_bulges_are_separated_from_the_delay(height_m):
    found = aligned(carton_capture(bulge=bulged(height_m)), PRIOR)
    assert abs(found.delay_m) < 2.0 * found.delay_sigma_m
    assert found.delay_m == pytest.approx(0.0, abs=1e-3)
    assert found.bulge_m == pytest.approx(height_m, abs=1e-3)
    assert np.rad2deg(np.abs(found.rotation_rad).max()) < 0.2


@pytest.fixture(scope="module")
def problem(capture):
    return WallProblem(capture, PRIOR, AlignmentConfig(), KeptPeaks(PRIOR))


def log_posterior(problem, values, walls, some):
    """Twin: written from the densities, with residuals from geometry alone."""
    n_walls = len(problem.faces.centers)
    parts = {name: values[index] for name, index in problem.parts.items()}
    shapes, total = parts["shapes"].reshape(n_walls, -1), 0.0
    for peak, wall, far in zip(walls.index, walls.walls, walls.far, strict=True):
        side, center = -1.0 if far else 1.0, problem.echoes.centers[peak]
        back = Rotation.from_rotvec(-parts["rotation"])
        center = back.apply(center - problem.center - parts["translation"]) + problem.center
        direction = back.apply(problem.echoes.directions[peak])
        normal, q = problem.faces.normals[wall], problem.faces.centers[wall]
        height = normal @ (center - q)
        half = 1.0 / np.linalg.norm(problem.faces.across[wall], axis=1)
        units = problem.faces.across[wall] * half[:, None]

        def shape(position, half=half, wall=wall):
            x, y = position / half
            waves = [
                np.sin(0.5 * np.pi * m * (x + 1)) * np.sin(0.5 * np.pi * n * (y + 1))
                for m in (1, 2, 3)
                for n in (1, 2, 3)
            ]
            return shapes[wall] @ [1.0, x, y, *waves]

        position, eps = units @ (center - q), 1e-6
        slope = [
            (shape(position + eps * e) - shape(position - eps * e)) / (2 * eps) for e in np.eye(2)
        ]
        behind = problem.echoes.ranges_m[peak] - parts["delay"][0] - side * height
        middle = problem.middles.depths_m[far] + parts["middles"][far] + parts["middles"][2]
        range_sigma, direction_sigma = ((4e-4, 0.01), (6e-4, 0.015))[far]
        residual = [(behind - middle + side * shape(position)) / range_sigma]
        residual += list((units @ direction - side * np.array(slope)) / direction_sigma)
        # Student-t of four degrees of freedom in three dimensions; four echoes count as one.
        total -= 0.25 * 3.5 * np.log1p(np.dot(residual, residual) / 4.0)
    delay, *others = values[some] / problem.sigmas[some]
    return total - 2.5 * np.log1p(delay**2 / 4.0) - 0.5 * np.square(others).sum()


def test_normal_equations_are_derivatives_of_the_log_posterior(problem):
    """Gradient by central differences of an independent twin, at a random point."""
    rng = np.random.default_rng(0)
    some = problem.sigmas > 0.0
    values = np.where(some, 0.1 * np.minimum(problem.sigmas, 0.01), 0.0)
    values *= rng.normal(size=len(values))
    walls = problem.walls_of(values, 0.5)
    walls = walls.select(np.arange(len(walls.index)) % 6 == 0)
    assert {0, 1} == set(walls.far)
    matrix, gradient = problem.normal_equations(values, walls, some)
    assert np.linalg.eigvalsh(matrix).min() > 0.0
    for number, column in enumerate(np.flatnonzero(some)):
        if number % 5:
            continue
        step = np.zeros(len(values))
        step[column] = 1e-3 * min(problem.sigmas[column], 1e-3)
        high, low = (log_posterior(problem, values + s * step, walls, some) for s in (1.0, -1.0))
        slope = -(high - low) / (2.0 * step[column])
        # Linearised about no turn: derivatives by angles of half a milliradian are 1e-3 off.
        assert gradient[number] == pytest.approx(slope, rel=5e-3, abs=1e-3 * abs(gradient).max())
