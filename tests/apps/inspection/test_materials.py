"""Material of parts from levels of returns that are made up."""

import numpy as np
import pytest
from scipy.stats import norm

from geraf2.apps.inspection.bodies import body_of
from geraf2.apps.inspection.material import Measured, material_text
from geraf2.apps.inspection.materials import (
    Levels,
    log_odds_of_metal,
    materials_of,
    reflectivity_map,
)
from helpers.solids import ball

METAL_DB, PLASTIC_DB = -3.1, -3.1 - 11.7 + 4.3  # permittivity 2.9


def levels(mesh, level_db, *, scale_sigma_db=0.5, back=(), permittivity=None, n=200):
    """Levels on a ball, 3 dB apart, and glints seen through it."""
    rng = np.random.default_rng(0)
    at = rng.permutation(len(mesh.vertices))[:n]
    normals = mesh.vertices[at] / np.linalg.norm(mesh.vertices[at], axis=1, keepdims=True)
    spread = norm.ppf(0.9) * 3.0
    behind = np.asarray(back, dtype=float).reshape(-1, 3)
    return Levels(
        positions=mesh.vertices[at],
        normals=normals,
        levels_db=level_db - spread + 3.0 * rng.normal(size=len(at)),
        scale_sigma_db=scale_sigma_db,
        back=behind,
        back_normals=np.tile([1.0, 0, 0], (len(behind), 1)),
        permittivity=permittivity,
    )


def test_the_log_odds_are_those_of_two_normal_levels():
    level = Measured(value=-6.0, sigma=1.5)
    spread = np.hypot(1.5, 2.0)
    wanted = norm.logpdf(-6.0, METAL_DB, spread) - norm.logpdf(-6.0, PLASTIC_DB, spread)
    assert log_odds_of_metal(level, 0.0) == pytest.approx(wanted, abs=0.02)
    assert log_odds_of_metal(None, 0.0) == 0.0
    assert log_odds_of_metal(None, 0.3) < -3.0


@pytest.mark.parametrize(
    ("level_db", "kind"),
    [(0.0, "metal"), (-6.8, "not determined"), (-14.0, "plastic")],
)
def test_the_level_decides_and_is_unsure_between_both(level_db, kind):
    mesh = ball(0.03, 3)
    (found,) = materials_of([body_of(mesh)], levels(mesh, level_db))
    assert found.kind == kind
    assert found.reflectivity_db.value == pytest.approx(level_db, abs=1.0)
    assert "dB against metal" in material_text(found)


def test_nothing_is_claimed_without_a_scale_with_few_returns_or_above_metal():
    mesh = ball(0.03, 3)
    bodies = [body_of(mesh)]
    for seen in (
        None,
        levels(mesh, np.nan, scale_sigma_db=np.nan),
        levels(mesh, 0.0, scale_sigma_db=6.0),
        levels(mesh, 0.0, n=10),
        levels(mesh, 12.0),
    ):
        (found,) = materials_of(bodies, seen)
        assert (found.kind, found.reflectivity_db) == ("not determined", None)


def test_glints_seen_through_one_of_two_parts_make_only_that_one_plastic():
    mesh = ball(0.03, 3)
    other = ball(0.03, 3)
    moved = type(mesh)(vertices=other.vertices + np.array([0, 0.2, 0]), faces=other.faces)
    unknown = levels(
        mesh,
        np.nan,
        scale_sigma_db=np.nan,
        back=[[-0.045, 0.001 * k, 0.0] for k in range(60)],
        permittivity=Measured(value=2.9, sigma=0.1),
    )._replace(thickness_m=(0.021, 0.058))
    first, second = materials_of([body_of(mesh), body_of(moved)], unknown)
    assert (first.kind, second.kind) == ("plastic", "not determined")
    assert first.permittivity.value == 2.9
    assert material_text(first).endswith(
        "permittivity 2.90 ± 0.20, 21 to 58 mm thick where both faces were seen"
    )
    assert (second.permittivity, second.thickness_m) == (None, None)
    (blind, _) = materials_of(
        [body_of(mesh), body_of(moved)], unknown._replace(permittivity=None, thickness_m=None)
    )
    assert material_text(blind).endswith("permittivity cannot be determined")


def test_the_map_has_the_levels_where_returns_came_from_and_nothing_elsewhere():
    mesh = ball(0.03, 4)
    normals = mesh.vertices / 0.03
    right = mesh.vertices[:, 0] > 0.0
    seen = levels(mesh, 0.0, n=len(mesh.vertices))
    keep = seen.positions[:, 0] > 0.0
    level = np.where(seen.positions[:, 1] > 0.0, -3.0, -9.0)
    half = seen._replace(
        positions=seen.positions[keep], normals=seen.normals[keep], levels_db=level[keep]
    )
    found = reflectivity_map(mesh.vertices, normals, half)
    assert np.isnan(found[mesh.vertices[:, 0] < -0.009]).all()
    far = right & (np.abs(mesh.vertices[:, 1]) > 0.01)
    assert found[far] == pytest.approx(np.where(mesh.vertices[far, 1] > 0, -3.0, -9.0))
