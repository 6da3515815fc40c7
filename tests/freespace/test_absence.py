from dataclasses import replace

import numpy as np
import pytest
import trimesh
from scipy.spatial import KDTree

from geraf2.echoes.glint_set import Glints
from geraf2.echoes.glints import GlintConfig
from geraf2.freespace.absence import SOFT_M, refuted
from geraf2.ops.visibility import MeshScene
from geraf2.scene import Capture, LosPrior, Pose
from geraf2.scene.aperture import apertures_of
from geraf2.surfaces.fit import Evidence, FitConfig, fit_sdf
from helpers.shadows import outlines
from helpers.specular import STANDOFF_M, antennas, fibonacci_sphere, raster
from helpers.synthetic import WAVEFORM

RADIUS_M = 0.04
HALF_M = 0.06
MARGIN_M = 0.02
RULE = {"margin_m": MARGIN_M, "reach_m": 0.010, "angle_rad": 0.6}


def poses(n=12):
    made = []
    for number in range(n):
        tx, rx, axes = antennas(360.0 * number / n, raster(13, 0.01))
        signal = np.zeros((len(tx), 2), dtype=np.complex64)
        made.append(Pose(signal=signal, tx_positions=tx, rx_positions=rx, axes=axes))
    return tuple(made)


@pytest.fixture(scope="module")
def apertures():
    return apertures_of(poses())


@pytest.fixture(scope="module")
def sphere():
    mesh = trimesh.creation.icosphere(subdivisions=4, radius=RADIUS_M)
    return np.asarray(mesh.vertices), np.asarray(mesh.faces)


def glints_at(directions):
    n = len(directions)
    return Glints(
        positions=RADIUS_M * directions,
        normals=directions,
        strengths=np.ones(n),
        position_sigma_m=np.ones(n),
        normal_sigma_rad=np.ones(n),
        poses=np.zeros(n, dtype=np.int64),
        probability=np.ones(n),
    )


COMPLETE = fibonacci_sphere(3000)


def faces_an_aperture(directions, margin_m=MARGIN_M):
    """Normals of a sphere about the origin that meet an aperture, by angles alone."""
    half = np.arctan((HALF_M - margin_m) / STANDOFF_M)
    azimuth = np.arctan2(directions[:, 1], directions[:, 0])
    azimuth = (azimuth + np.pi / 12) % (np.pi / 6) - np.pi / 12
    flat = np.hypot(directions[:, 0], directions[:, 1]) * np.cos(azimuth)
    rise = np.abs(directions[:, 2]) / np.maximum(flat, 1e-9)
    return (np.abs(azimuth) < half) & (rise < np.tan(half))


def test_nothing_is_refuted_where_everything_flashed(apertures, sphere):
    points = sphere[0]
    gone = refuted(
        points, points / RADIUS_M, MeshScene(*sphere), glints_at(COMPLETE), apertures, **RULE
    )
    assert not gone.any()


def patch_removed():
    """All but the glints within 20 degrees of +x."""
    return glints_at(COMPLETE[COMPLETE[:, 0] < np.cos(0.35)])


def test_exactly_the_patch_without_glints_is_refuted(apertures, sphere):
    normals = fibonacci_sphere(20000)
    points, glints = RADIUS_M * normals, patch_removed()
    gone = refuted(points, normals, MeshScene(*sphere), glints, apertures, **RULE)
    nearest = KDTree(glints.positions).query(points)[0]
    # Wholly and not at all, with the ramps between.
    wholly = faces_an_aperture(normals, MARGIN_M + SOFT_M) & (nearest > RULE["reach_m"] + SOFT_M)
    possibly = faces_an_aperture(normals, MARGIN_M - SOFT_M) & (nearest > RULE["reach_m"] - SOFT_M)
    assert (gone[wholly] == 1.0).all()
    assert (gone[~possibly] == 0.0).all()
    assert wholly.sum() >= 5
    assert (normals[gone > 0.0, 0] > 0.97).all()


def test_what_moves_a_little_is_refuted_a_little_more_or_less(apertures, sphere):
    """No limit is a step: 5 um of the surface never makes an echo absent that was none."""
    degrees = [
        refuted(
            sphere[0] + shift,
            sphere[0] / RADIUS_M,
            MeshScene(*sphere),
            patch_removed(),
            apertures,
            **RULE,
        )
        for shift in np.linspace(0.0, 3e-3, 601)[:, None] * [[0.0, 1.0, 0.0]]
    ]
    steps = np.abs(np.diff(degrees, axis=0))
    assert np.ptp(degrees, axis=0).max() > 0.5
    assert steps.max() < 5e-3  # 5 um of a ramp of 4 mm, and of the angle


def test_glints_that_face_elsewhere_explain_nothing(apertures, sphere):
    points = sphere[0]
    turned = glints_at(COMPLETE)
    turned = Glints(**{**vars(turned), "normals": -turned.normals})
    gone = refuted(points, points / RADIUS_M, MeshScene(*sphere), turned, apertures, **RULE)
    np.testing.assert_array_equal(gone > 0.5, faces_an_aperture(points / RADIUS_M))


def test_what_is_hidden_is_not_refuted(apertures, sphere):
    screen = LosPrior.from_box((0.01, 0.1, 0.1), center_m=(0.1, 0.0, 0.0))
    vertices = np.concatenate([sphere[0], screen.vertices])
    faces = np.concatenate([sphere[1], screen.faces + len(sphere[0])])
    points = sphere[0]
    gone = refuted(
        points, points / RADIUS_M, MeshScene(vertices, faces), patch_removed(), apertures, **RULE
    )
    assert not gone.any()


def test_near_the_wall_nothing_is_missed():
    """What flashes there is taken for the wall's echo, so that its absence says nothing."""
    capture = Capture(waveform=WAVEFORM, poses=poses())
    config = FitConfig(spacing_m=0.006, absence_margin_m=MARGIN_M, absence_weight=3.0)
    wide = LosPrior.from_box((0.3, 0.3, 0.3))
    # One wall of the box is 8 mm beyond the patch without glints.
    close = LosPrior.from_box((0.3, 0.3, 0.3), center_m=(RADIUS_M + 0.008 - 0.15, 0.0, 0.0))
    bulge = np.array([[RADIUS_M, 0.0, 0.0]])
    pulled, kept, unasked = (
        float(fit_sdf(patch_removed(), capture, box, rule).sample(bulge)[0])
        for box, rule in (
            (wide, config),
            (close, config),
            (wide, replace(config, absence_weight=0.0)),
        )
    )
    assert kept == unasked
    assert pulled > kept + 2e-3
    thin = Evidence(glints=patch_removed(), found_with=GlintConfig(wall_margin_m=0.004))
    assert float(fit_sdf(thin, capture, close, config).sample(bulge)[0]) > kept + 2e-3


def test_where_an_outlines_edge_touches_nothing_is_absent():
    """Of a patch without glints, that faces an antenna."""
    capture, box = Capture(waveform=WAVEFORM, poses=poses()), LosPrior.from_box((0.3, 0.3, 0.3))
    config = FitConfig(spacing_m=0.006, absence_margin_m=MARGIN_M, absence_weight=3.0)
    alone = Evidence(glints=patch_removed())
    # Its edge is 2 mm outside of the patch, and 9 mm outside of everything else.
    reaches = outlines([1], [RADIUS_M + 0.002, 2.0 * RADIUS_M, RADIUS_M + 0.009])
    bulge = np.array([[RADIUS_M + 0.002, 0.0, 0.0]])
    gone, drawn = (
        float(fit_sdf(evidence, capture, box, config).sample(bulge)[0])
        for evidence in (
            alone,
            replace(alone, outlines=reaches, outline_weight=0.05, outline_clearance_m=0.005),
        )
    )
    assert gone > 0.003
    assert abs(drawn) < 0.0015
