"""Cutting of streams that are made of power alone."""

from dataclasses import replace

import numpy as np
import pytest

from geraf2.apps.belt.cutting import Cutter
from geraf2.errors import UserError
from geraf2.io.belt_file import BeltRecord, BeltStation
from geraf2.records import Pose

STEP = 0.004
STATIONS = tuple(
    BeltStation(
        name=name,
        station_m=station,
        tx_m=tuple((station, 0.3, 0.01 * k) for k in range(3)),
        rx_m=tuple((station, 0.3, 0.01 * k) for k in range(3)),
        delays_s=(0.0, 0.0, 0.0),
    )
    for name, station in (("left", 0.0), ("speed", 0.3))
)
RECORD = BeltRecord(arrays=STATIONS, speed_m_per_s=0.5, frame_s=STEP / 0.5, travel_m=0.8)


def plane(array, x, parcels, name=0):
    """Plane of an array in front of x (n_frames,), with parcels as (start, end) along x."""
    inside = np.any([(x > start) & (x < end) for start, end in parcels], axis=0)
    level = np.where(inside, 1.0, 0.1)
    shift = np.stack([x - array.station_m, 0.0 * x, 0.0 * x], axis=1)
    positions = (np.array(array.tx_m) + shift[:, None]).reshape(-1, 3)
    signal = np.repeat(level, 3)[:, None] * np.ones(8, np.complex64)
    return Pose(
        signal=signal.astype(np.complex64),
        tx_positions=positions,
        rx_positions=positions,
        axes=np.eye(3),
        name=f"{array.name}/{name}",
    )


def stream(parcels, *, low=-3.0, high=0.6, chunk_m=0.3):
    planes = []
    for number, top in enumerate(np.arange(high, low, -chunk_m)):
        x = np.arange(top, top - chunk_m + 1e-9, -STEP)
        planes += [plane(array, x, parcels, number) for array in STATIONS]
    return planes


def cut(planes, longest_m=0.5, *, at_once=False):
    cutter, spans, problems = Cutter(RECORD, longest_m), [], []
    for number, pose in enumerate(planes):
        try:
            cutter.add(pose, number)
        except UserError as error:
            problems.append(str(error))
        if not at_once:
            spans += list(cutter.pop_parcels())
    return [*spans, *cutter.pop_parcels(is_last=True)], problems


PARCELS = [(-0.15, 0.15), (-1.1, -0.8), (-1.9, -1.5)]


def test_parcels_are_found_where_they_are_in_the_order_of_the_belt():
    spans, problems = cut(stream(PARCELS))
    assert not problems
    assert [span.number for span in spans] == [1, 2, 3]
    for span, (start, end) in zip(spans, PARCELS, strict=True):
        assert span.start_m == pytest.approx(start, abs=0.008)
        assert span.end_m == pytest.approx(end, abs=0.008)
        assert not span.problem
        assert span.high_m - span.low_m == pytest.approx(0.8, abs=0.05)
        assert span.planes
    # The result does not depend on when planes come.
    assert cut(stream(PARCELS), at_once=True)[0] == spans


def test_a_window_ends_halfway_to_the_neighbour():
    spans, _ = cut(stream([(-0.1, 0.1), (-0.5, -0.3)]))
    assert spans[0].low_m == spans[1].high_m == pytest.approx(-0.2, abs=0.008)


def test_parcels_that_touch_are_one_line_and_the_next_is_found():
    spans, _ = cut(stream([(-0.3, 0.0), (-0.6, -0.31), (-1.7, -1.4)]))
    assert "parcels touch" in spans[0].problem
    assert "0.6" in spans[0].problem
    assert not spans[1].problem
    assert spans[1].middle_m == pytest.approx(-1.55, abs=0.008)


def test_a_belt_that_stops_repeats_frames_which_are_dropped():
    planes = stream([(-0.15, 0.15)], low=-1.2)
    still = replace(planes[4], name="left/99")
    first = np.repeat(planes[4].phase_centers[-3:][None], 20, axis=0).reshape(-1, 3)
    still = replace(
        still, tx_positions=first, rx_positions=first, signal=np.ones((60, 8), np.complex64)
    )
    cutter = Cutter(RECORD, 0.5)
    stood = [cutter.add(pose, k) for k, pose in enumerate([*planes[:5], still, *planes[5:]])]
    assert sum(stood) == 20
    spans = list(cutter.pop_parcels(is_last=True))
    assert [(s.start_m, s.end_m) for s in spans] == [(s.start_m, s.end_m) for s in cut(planes)[0]]


def test_travel_that_goes_back_leaves_the_plane_out():
    planes = stream(PARCELS)
    back = replace(planes[0], name="left/98")
    spans, problems = cut([*planes[:6], back, *planes[6:]])
    assert [s.start_m for s in spans] == [s.start_m for s in cut(planes)[0]]
    assert len(problems) == 1
    assert "goes back" in problems[0]
    assert "left/98" in problems[0]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda p: replace(p, name="right/0"), "no array of the belt"),
        (lambda p: replace(p, tx_positions=p.tx_positions + np.array([0.0, 0.01, 0])), "elsewhere"),
        (lambda p: p.select(np.arange(1, p.n_antennas)), "parts of frames"),
    ],
)
def test_a_plane_that_contradicts_the_record_is_one_line(change, message):
    planes = stream(PARCELS)
    planes[3] = change(planes[3])
    spans, problems = cut(planes)
    assert len(problems) == 1
    assert message in problems[0]
    assert "\n" not in problems[0]
    assert [s.number for s in spans] == [1, 2, 3]
    assert "missing" in spans[0].problem
    assert not spans[2].problem


def test_an_empty_belt_has_no_parcel():
    assert cut(stream([(5.0, 6.0)]))[0] == []
