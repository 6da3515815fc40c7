"""Coverage of a belt's arrays against solid angles, and as `geraf2 plan --belt` prints it."""

import json

import numpy as np
import pytest

from geraf2.apps.belt.coverage import coverage
from geraf2.cli.main import main
from geraf2.simulation.belt_spec import BeltArraySpec, BeltSpec

SPEC = """
[figure]
name = "ball"
[belt]
[[belt.arrays]]
side = "left"
n_boards = 4
[[belt.arrays]]
side = "left"
name = "speed"
station_m = 0.3
[[belt.arrays]]
side = "above"
tx_m = [[-0.2, 0.0], [0.0, 0.0]]
rx_m = [[0.0, 0.0], [0.3, 0.0]]
"""


def described(rows_m, **changes):
    """Array of antennas at these positions across the travel."""
    positions = tuple((float(row), 0.0) for row in rows_m)
    return BeltArraySpec(side="left", tx_m=positions, rx_m=positions, standoff_m=0.35, **changes)


def test_a_point_is_seen_within_the_solid_angle_of_the_array():
    belt = BeltSpec(arrays=(described(np.linspace(-0.2, 0.2, 21)),), travel_m=1.0)
    (found,) = coverage(belt, (1e-6, 1e-6, 1e-6))
    a, b, d = 0.5, 0.2, 0.35
    angle = 4.0 * np.arcsin(a * b / np.sqrt((a**2 + d**2) * (b**2 + d**2)))
    assert found.seen_share == pytest.approx(angle / (4.0 * np.pi), rel=0.03)
    assert found.never_seen == ("right", "above", "below")
    assert found.by_side["front"] == pytest.approx(found.by_side["back"], abs=0.01)


def test_an_array_adds_what_the_others_do_not_see():
    side = described(np.linspace(-0.2, 0.2, 21))
    same = described(np.linspace(-0.2, 0.2, 21), name="same", station_m=0.3)
    opposite = BeltArraySpec(side="right", n_boards=4)
    one, two, three = coverage(BeltSpec(arrays=(side, same, opposite)), (0.3, 0.3, 0.3))
    assert one.seen_share == two.seen_share < three.seen_share
    assert three.never_seen == ("above", "below")
    # 21 receivers take 6 chips, a cascade has 4.
    assert [x.n_chips for x in (one, two, three)] == [7, 14, 30]


def test_a_plan_prints_what_each_array_adds(tmp_path, capsys):
    (tmp_path / "belt.toml").write_text(SPEC)
    arguments = ["plan", "--belt", str(tmp_path / "belt.toml"), "--box", "0.3", "0.3", "0.26"]
    assert main(arguments) == 0
    shown = capsys.readouterr()
    assert "left            4     16     12 %  right, above, below" in shown.out
    assert "+ speed         5     20     12 %  right, above, below" in shown.out
    assert "from left and speed" in shown.out
    assert "array above: baselines of up to 300 mm that differ" in shown.err
    assert main([*arguments, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["arrays"][0]["n_chips"] == 16
