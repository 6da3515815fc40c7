"""Levels that the material decision uses, against the Mie series of spheres and a layered slab."""

import numpy as np
import pytest

from geraf2.apps.inspection import materials
from geraf2.apps.inspection.material import Measured
from geraf2.apps.inspection.materials import log_odds_of_metal
from geraf2.constants import SPEED_OF_LIGHT_M_PER_S
from geraf2.echoes.reflectivity import db, face_reflection, spreading
from reference.mie import backscatter_m, front_echo_m

F = 77e9 + np.linspace(0.0, 4e9, 64)  # 79 GHz in the middle
K = 2.0 * np.pi * F / SPEED_OF_LIGHT_M_PER_S
RADIUS_M = 0.06
LOSS = 1.0 + 0.03j
"""Of plastic: the back face, else 15 dB above the front and in its side lobes, is silent."""


def level_db(**sphere):
    """Front echo of a sphere against that of metal [dB]."""
    metal = front_echo_m(K, backscatter_m(K, RADIUS_M), RADIUS_M)
    echo = front_echo_m(K, backscatter_m(K, RADIUS_M, **sphere), RADIUS_M)
    return float(db(np.array(echo / metal)))


@pytest.mark.parametrize("radius_m", [0.02, 0.03, 0.05])
def test_a_metal_sphere_has_the_amplitude_that_levels_refer_to(radius_m):
    far = np.array([100.0])
    wanted = far**2 * spreading(far, np.diag([0.0, 1.0, 1.0])[None] / radius_m)
    wanted *= (far + radius_m) / far  # Mie counts from the centre
    assert np.abs(backscatter_m(K, radius_m)) == pytest.approx(float(wanted[0]), rel=0.03)


@pytest.mark.parametrize("permittivity", [2.3, 2.7, 3.3])
def test_the_front_of_a_plastic_sphere_has_its_fresnel_level(permittivity):
    wanted = db(np.abs(np.array(face_reflection(permittivity))))
    assert level_db(permittivity=permittivity * LOSS) == pytest.approx(float(wanted), abs=0.2)


@pytest.mark.parametrize(
    ("sphere", "is_metal"),
    [
        ({}, True),
        ({"permittivity": 2.7 * LOSS}, False),
        ({"permittivity": 2.9 * LOSS, "coat_m": 0.001}, True),
    ],
)
def test_the_front_echo_speaks_for_what_a_sphere_is_made_of(sphere, is_metal):
    """Painted metal is metal: the coat delays its echo and does not weaken it."""
    level = Measured(value=materials._METAL_DB + level_db(**sphere), sigma=1.0)
    assert (log_odds_of_metal(level, np.nan) > 0.0) == is_metal
