from dataclasses import replace

import numpy as np

from geraf2.simulation import WorldSpec, parse_spec
from geraf2.simulation.world import EFFECTS

FIGURE = {"figure": {"name": "dog"}}


def world(**table):
    return parse_spec(FIGURE | {"world": table}, where="spec.toml").world


def test_a_spec_without_the_table_is_off_and_a_preset_switches_on_all_but_the_dielectric():
    assert parse_spec(FIGURE).world == WorldSpec()
    assert WorldSpec().is_off
    assert WorldSpec().settings == {}
    everything = world(preset="plausible")
    dielectric = WorldSpec(preset="plausible", effects=("dielectric",))
    others = tuple(effect for effect in EFFECTS if effect != "dielectric")
    assert everything.settings == WorldSpec(preset="plausible", effects=others).settings
    assert dielectric.figure_permittivity > 1.0
    assert everything.figure_permittivity == WorldSpec().figure_permittivity


def test_single_values_override_the_preset_and_replace_keeps_the_others():
    got = world(preset="hard", effects=["bulge", "iq"], wall_bulge_m=0.002, dc_db=-np.inf)
    of_iq = WorldSpec(preset="hard", effects=("iq",)).settings
    of_iq.pop("dc_db", None)
    assert got.settings == {"wall_bulge_m": 0.002, **of_iq}
    assert world(leakage_db=3.0).settings == {"leakage_db": 3.0}
    assert replace(got, wall_bulge_m=0.0).settings == of_iq
