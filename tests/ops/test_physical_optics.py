from dataclasses import replace

import numpy as np
import pytest

from geraf2.ops.physical_optics import SurfaceElements, physical_optics
from geraf2.scene import Wall
from helpers.antennas import blocks_of
from helpers.synthetic import WAVEFORM, white_noise
from reference import physical_optics as reference
from reference.closeness import relative_error

BOX = Wall(size_m=(0.22, 0.24, 0.26), thickness_m=0.004, permittivity=1.6, center_m=(0, 0.01, 0))
WEIGHTS = white_noise((3, 40))
INNER = Wall(size_m=(0.1, 0.12, 0.12), thickness_m=0.003, permittivity=2.2)


def make_elements(n=40, **options):
    rng = np.random.default_rng(1)
    normals = rng.normal(size=(n, 3))
    normals[:, 0] = np.abs(normals[:, 0])
    return SurfaceElements(
        points=rng.uniform(-0.09, 0.09, (n, 3)),
        normals=normals / np.linalg.norm(normals, axis=1, keepdims=True),
        edges=rng.normal(size=(n, 2, 3)) * 4e-4,
        **options,
    )


def make_antennas(pattern_exponent=0):
    """23 irregular bistatic antennas in blocks of 20, 0 and 3."""
    rng = np.random.default_rng(2)
    tx = np.array([0.4, 0.0, 0.0]) + rng.uniform(-0.02, 0.02, (23, 3))
    rx = tx + np.array([0.01, -0.05, 0.02])
    return blocks_of(tx, rx, offsets=[0, 20, 20, 23], pattern_exponent=pattern_exponent)


def expected_signal(elements, antennas, walls):
    options = {
        "normals": elements.normals,
        "edges": elements.edges,
        "shape": elements.shape,
        "reflector": elements.reflector,
        "slab": elements.slab,
        "slab_crossing": elements.slab_crossing,
        "walls": walls,
        "boresight": antennas.boresight,
        "exponent": antennas.pattern_exponent,
    }
    block_of = np.repeat(np.arange(3), np.diff(antennas.offsets))
    return np.array(
        [
            reference.echo(elements.points, WEIGHTS[b], tx, rx, WAVEFORM, **options)
            for b, tx, rx in zip(block_of, antennas.tx, antennas.rx, strict=True)
        ]
    )


@pytest.mark.parametrize(
    ("options", "walls", "exponent"),
    [
        ({}, (), 0),
        ({}, (), 2),
        ({}, (BOX,), 0),
        ({}, (BOX, INNER), 0),
        ({"shape": "rectangle"}, (BOX,), 1),
        ({"shape": "rectangle", "reflector": "slab", "slab": BOX}, (), 0),
        (
            {"shape": "rectangle", "reflector": "slab", "slab": BOX, "slab_crossing": 0.8},
            (INNER,),
            0,
        ),
    ],
)
def test_echo_agrees_with_the_term_by_term_sum(options, walls, exponent):
    elements, antennas = make_elements(**options), make_antennas(exponent)
    expected = expected_signal(elements, antennas, walls)
    got_double = physical_optics(elements, WEIGHTS, antennas, WAVEFORM, walls=walls)
    # Left: float64 rounding of 1e3 rad, 32 steps. The form factor of a rectangle is linear in
    # frequency: 1.3 rad change by 2.3 % over half the band, (0.03)^2 / 6 is left out.
    assert relative_error(got_double, expected) < (3e-4 if elements.shape == "rectangle" else 1e-8)
    got_float = physical_optics(
        elements, WEIGHTS.astype(np.complex64), antennas, WAVEFORM, walls=walls
    )
    assert got_float.dtype == np.complex64
    # 32 recurrence steps of 6e-8, 60 rad of offset phase at 6e-8, cancelling sum of 40.
    assert relative_error(got_float, got_double) < 3e-5


@pytest.mark.parametrize("box", [BOX, None])
def test_a_raster_agrees_with_the_term_by_term_sum(box):
    """A ball of many elements, seen through three sides of the box, from neighbouring antennas."""
    rng = np.random.default_rng(3)
    normals = rng.normal(size=(3000, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    ball = SurfaceElements(points=0.03 * normals + [0.03, 0.03, 0.03], normals=normals)
    axes = np.linalg.qr(np.array([[1.0, 1.0, 0.9], [-1, 1, 0], [0, 0, 1]]).T)[0].T
    u, v = (g.ravel() for g in np.meshgrid(*[0.004 * (np.arange(10) - 4.5)] * 2, indexing="ij"))
    middle = 0.3 * np.sign(axes[0, 0]) * axes[0] + u[:, None] * axes[1] + v[:, None] * axes[2]
    middle += 5e-5 * rng.normal(size=middle.shape)  # they jitter
    antennas = replace(
        blocks_of(middle + 0.003 * axes[1], middle - 0.003 * axes[1], offsets=[0, 100]),
        boresight=axes[0],
    )
    weights = 1.0 + 0.3j * rng.normal(size=(1, 3000))
    walls = () if box is None else (box,)
    chosen = [0, 34, 69, 95]
    expected = np.array(
        [
            reference.echo(
                ball.points, weights[0], tx, rx, WAVEFORM, normals=ball.normals, walls=walls
            )
            for tx, rx in zip(antennas.tx[chosen], antennas.rx[chosen], strict=True)
        ]
    )
    got_double = physical_optics(ball, weights, antennas, WAVEFORM, walls=walls)
    assert relative_error(got_double[chosen], expected) < 1e-8
    got_float = physical_optics(ball, weights.astype(np.complex64), antennas, WAVEFORM, walls=walls)
    # Four nodes a side leave 3e-3 of an element in the corner of a cell at the end of a block;
    # weak samples are where the elements cancel.
    assert relative_error(got_float, got_double) < 3e-3


def test_triangle_form_factor_is_that_of_the_block_centre():
    elements, antennas = make_elements(shape="triangle"), make_antennas()
    centers = blocks_of(antennas.tx[0], antennas.rx[0])
    got = physical_optics(elements, WEIGHTS[:1], centers, WAVEFORM)
    options = {"normals": elements.normals, "edges": elements.edges, "shape": "triangle"}
    expected = reference.echo(
        elements.points, WEIGHTS[0], centers.tx[0], centers.rx[0], WAVEFORM, **options
    )
    # The reference cuts a side of up to 5 rad into 200: (5 / 200)^2 / 36 of each term is left.
    assert relative_error(got[0], expected) < 2e-5


def test_a_wide_triangle_is_the_sum_of_its_parts():
    """Thirty half turns across it: the power series of small phases would be off by 1e11."""
    corners = np.array([[0.0, 0.02, 0.005], [0.0, -0.01, 0.015], [0.0, -0.01, -0.02]])
    n = 32
    tx = 1e5 * np.array([[1.0, 1.0, 0.5]])  # far away, where the phase is linear
    antennas = blocks_of(tx)

    def echo(centroids, edges, weight):
        elements = SurfaceElements(
            points=centroids,
            normals=np.tile([1.0, 0.0, 0.0], (len(centroids), 1)),
            edges=np.array(edges),
            shape="triangle",
        )
        weights = np.full((1, len(centroids)), weight + 0j)
        # a form factor is that of mid-band: one frequency
        return physical_optics(elements, weights, antennas, replace(WAVEFORM, n_samples=1))

    side_1, side_2 = corners[1] - corners[0], corners[2] - corners[0]
    positions, shapes = [], []
    for i in range(n):
        for j in range(n - i):
            for up in (True, False) if j < n - i - 1 else (True,):
                at = (i + 1 / 3, j + 1 / 3) if up else (i + 2 / 3, j + 2 / 3)
                positions.append(corners[0] + (at[0] * side_1 + at[1] * side_2) / n)
                turn = 1.0 if up else -1.0
                shapes.append(turn * corners[:2] / n)
    assert len(positions) == n * n
    whole = echo(np.zeros((1, 3)), [corners[:2]], 1.0)
    np.testing.assert_allclose(
        whole,
        echo(np.array(positions), shapes, 1.0 / n**2),
        rtol=0,
        atol=1e-3 * np.abs(whole).max(),
    )


@pytest.mark.parametrize("angle_deg", [0.0, 35.0])
def test_a_wall_delays_and_weakens_by_fresnel(angle_deg):
    angle = np.deg2rad(angle_deg)
    slab = Wall(size_m=(0.2, 5.0, 5.0), thickness_m=0.004, permittivity=1.6)
    position = 0.5 * np.array([np.cos(angle), np.sin(angle), 0.0])
    antennas = blocks_of(position, boresight=-position / 0.5)
    point, one = SurfaceElements(points=np.zeros((1, 3))), np.ones((1, 1), np.complex128)
    free = physical_optics(point, one, antennas, WAVEFORM)[0]
    behind = physical_optics(point, one, antennas, WAVEFORM, walls=(slab,))[0]
    cos = np.cos(angle)
    inner = np.sqrt(1.6 - np.sin(angle) ** 2)
    delay = 2 * 0.004 * (inner - cos)
    r = (cos - inner) / (cos + inner)
    wavenumbers = 2 * np.pi * WAVEFORM.frequencies_hz / 299792458.0
    expected = (1 - r**2) ** 2 * np.exp(-1j * wavenumbers * delay)
    assert np.abs(behind / free - expected).max() < 1e-9
    if angle_deg == 0:
        assert delay == pytest.approx(2 * slab.one_way_delay_m)


def test_elements_facing_away_and_empty_sets_give_silence():
    antennas = make_antennas()
    hidden = SurfaceElements(points=np.zeros((1, 3)), normals=np.array([[-1.0, 0.0, 0.0]]))
    assert not physical_optics(hidden, np.ones((3, 1), complex), antennas, WAVEFORM).any()
    nothing = SurfaceElements(points=np.zeros((0, 3)))
    empty = physical_optics(nothing, np.zeros((3, 0), complex), antennas, WAVEFORM)
    assert empty.shape == (23, 32)
    assert not empty.any()


def test_strided_input_changes_nothing():
    elements, antennas = make_elements(), make_antennas()
    wide = np.repeat(WEIGHTS, 2, axis=1)[:, ::2]
    assert np.array_equal(
        physical_optics(elements, wide, antennas, WAVEFORM),
        physical_optics(elements, WEIGHTS, antennas, WAVEFORM),
    )
