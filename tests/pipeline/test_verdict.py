"""The verdict: what each test adds to the odds, and the causes that it names."""

from dataclasses import replace

import numpy as np
import pytest

import geraf2
from geraf2.echoes.plane_agreement import PlaneAgreement, Rival
from geraf2.io.verdict import Trust
from geraf2.pipeline.plane_check import PlaneCheck
from geraf2.pipeline.verdict import DelayByWalls, RunTests
from geraf2.scene.aperture import Aperture
from geraf2.surfaces.confirmation import Confirmation
from helpers.solids import ball
from helpers.specular import frame


def agreement(share):
    return PlaneAgreement(
        share=share,
        of_planes=np.full(12, share),
        log_likelihood=np.full(12, share),
        n_pairs=np.full(12, 100),
    )


PLANES = PlaneCheck(
    recorded=agreement(0.45),
    reversed_turn=Rival(share=0.02, sigmas=-5.0),
    upside_down=Rival(share=0.45, sigmas=0.0),
)
SOUND = RunTests(
    planes=PLANES,
    is_turned=False,
    echoes=Confirmation(visible=0.35, confirmed=0.92),
    radius_m=0.008,
    walls=DelayByWalls(),
    error_m=0.001,
    seen=0.5,
    saturation=0.0,
    plastic=0.0,
    mesh=ball(0.05),
    apertures=tuple(
        Aperture.from_rectangle(-0.4 * (axes := frame(30.0 * k))[0], axes, np.array([0.07, 0.1]))
        for k in range(12)
    ),
)
LOW = SOUND.apertures[:2]
UP = np.array([0.0, 0.0, 0.2])
HIGH = tuple(Aperture.from_rectangle(p.middle_m + UP, p.axes, p.half_m) for p in SOUND.apertures)


def test_a_sound_run_is_reliable_and_has_no_cause():
    verdict = SOUND.verdict()
    assert verdict.trust == Trust.RELIABLE
    assert verdict.probability_of_failure < 0.02
    assert verdict.causes == ()


@pytest.mark.parametrize(
    ("change", "cause"),
    [
        ({"planes": replace(PLANES, reversed_turn=Rival(share=0.4, sigmas=5.0))}, "sense"),
        ({"is_turned": True}, "sense"),
        ({"planes": replace(PLANES, upside_down=Rival(share=0.6, sigmas=3.0))}, "axes"),
        ({"planes": replace(PLANES, exchanged=((2, 7),))}, "swapped"),
        ({"planes": replace(PLANES, recorded=agreement(0.02))}, "planes"),
        ({"radius_m": -0.03}, "delay"),
        ({"radius_m": 0.09}, "delay"),
        ({"walls": DelayByWalls(odds=12.0, other_m=0.25, used_m=0.15)}, "delay"),
        ({"radius_m": -0.03, "walls": DelayByWalls(odds=-9.0)}, "plastic"),
        ({"saturation": 0.02}, "saturated"),
        ({"plastic": 0.4}, "plastic"),
        ({"apertures": LOW}, "few planes"),
        ({"apertures": HIGH}, "height"),
        ({}, "uncertain"),
    ],
)
def test_what_a_test_shows_is_the_first_cause(change, cause):
    poor = replace(SOUND, error_m=0.015, seen=0.06, echoes=Confirmation(visible=0.1, confirmed=0.3))
    verdict = replace(poor, **change).verdict()
    assert verdict.trust == Trust.NOT_TO_BE_TRUSTED
    assert verdict.causes[0].name == cause
    assert verdict.causes[0].action


@pytest.mark.parametrize(
    "worse",
    [
        {"error_m": 0.006},
        {"seen": 0.05},
        {"echoes": Confirmation(visible=0.35, confirmed=0.3)},
        {"planes": replace(PLANES, recorded=agreement(0.02))},
        {"planes": replace(PLANES, reversed_turn=Rival(share=0.4, sigmas=3.0))},
        {"radius_m": -0.03},
    ],
)
def test_each_test_raises_the_probability(worse):
    found = replace(SOUND, **worse).verdict().probability_of_failure
    assert found > 1.5 * SOUND.verdict().probability_of_failure


def test_planes_without_common_echoes_say_nothing_about_their_geometry():
    alone = PlaneAgreement(
        share=0.0,
        of_planes=np.full(2, np.nan),
        log_likelihood=np.zeros(2),
        n_pairs=np.zeros(2, dtype=int),
    )
    same = replace(SOUND, planes=replace(PLANES, recorded=alone)).verdict()
    assert same.probability_of_failure == SOUND.verdict().probability_of_failure


def test_a_run_is_judged_and_a_baseline_is_not():
    verdict = geraf2.examples.small_run().verdict
    assert 0.0 < verdict.probability_of_failure < 1.0
    assert {"agreement", "confirmed", "modal_radius_mm"} <= set(verdict.tests)
    capture, _ = geraf2.examples.small_capture()
    baseline = geraf2.reconstruct(capture, geraf2.examples.BOX_M, "back-projection")
    assert baseline.verdict is None
