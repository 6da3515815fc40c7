"""The list of contents: assignment by size and material, and lists that are no use."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

from geraf2.apps.inspection.bodies import body_of, measure
from geraf2.apps.inspection.expected import (
    ExpectedContents,
    ExpectedItem,
    absence_failures,
    assigned,
    list_findings,
    log_odds,
    read_expected,
)
from geraf2.apps.inspection.material import Material
from geraf2.cli.main import main
from geraf2.errors import UserError
from helpers.inspected import block, run_of, wedge


def material(metal):
    kind = "metal" if metal > 0.95 else "plastic" if metal < 0.05 else "not determined"
    return Material(
        kind=kind,
        metal_probability=metal,
        reflectivity_db=None,
        permittivity=None,
        thickness_m=None,
        n_returns=50,
    )


def part(sides_m, metal=0.5):
    return measure(body_of(block(sides_m)), material(metal))


def item(size_mm, material=None):
    return ExpectedItem(name="thing", size_mm=size_mm, material=material)


def test_the_log_odds_are_those_of_two_normal_distributions():
    found, metal = part((0.05, 0.03, 0.02), 0.9), item((20.0, 52.0, 31.0), "metal")
    wanted = 0.0
    lengths = sorted(found.dimensions_m, key=lambda length: length.value)
    for length, side in zip(lengths, (0.020, 0.031, 0.052), strict=True):
        for sign, own in ((1, 0.004), (-1, 0.05)):
            wanted += sign * norm.logpdf(length.value, side, np.hypot(length.sigma, own))
    assert log_odds(found, metal) == pytest.approx(wanted)


def test_parts_are_assigned_as_a_whole_by_size_and_material():
    parts = [part((0.05, 0.03, 0.02)), part((0.02, 0.02, 0.02)), part((0.2, 0.1, 0.1))]
    items = [item((20, 20, 20)), item((50, 30, 20))]
    assert assigned(parts, items) == {0: 1, 1: 0}
    alike = [part((0.03,) * 3, 0.02), part((0.03,) * 3, 0.98)]
    wanted = [item((30, 30, 30), "metal"), item((30, 30, 30), "plastic")]
    assert assigned(alike, wanted) == {0: 1, 1: 0}
    assert assigned(alike[:1], wanted[:1]) == {0: 0}  # of another material, and still there
    assert assigned(parts, [item((100, 5, 5))]) == {}
    assert assigned([], items) == {}


def failures(parts, *items):
    found = list_findings(parts, ExpectedContents(item=items), [], [])
    absent = absence_failures(parts, found.missing, found.spare, is_list=True)
    return [*found.failures, *absent]


def test_a_part_of_another_material_is_one_fault():
    parts = [part((0.05, 0.03, 0.02), 0.99), part((0.03, 0.03, 0.03), 0.01)]
    items = item((50, 30, 20), "metal"), replace(item((30, 30, 30), "metal"), name="cube")
    assert failures(parts, *items) == ["'cube' is of plastic, not of metal"]


def test_a_part_of_a_similar_size_in_the_position_of_another_is_one_fault():
    parts = [part((0.05, 0.03, 0.02), 0.99), part((0.045, 0.045, 0.01), 0.01)]
    items = item((50, 30, 20)), replace(item((40, 40, 40)), name="cube")
    wanted = "'cube' is swapped: part 2 is there instead, 45 x 45 x 10 mm, plastic"
    assert failures(parts, *items) == [wanted]
    small = part((0.01, 0.01, 0.01))
    found = failures([parts[0], small], *items)
    assert found[0] == "'cube' is missing"
    assert found[1].startswith("part 2 is surplus: 10 x 10 x 10 mm")


BLOCK = '[[item]]\nname = "block"\nsize_mm = [20.0, 15.0, 30.0]\n'
WEDGE = '[[item]]\nname = "wedge"\nsize_mm = [60.0, 40.0, 30.0]\n'
PLATE = '[[item]]\nname = "plate"\nsize_mm = [40.0, 10.0, 2.0]\n'
SCREW = '[[item]]\nname = "screw"\nsize_mm = [90.0, 5.0, 5.0]\n'


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    small = block((0.02, 0.015, 0.03), (0.07, 0.0, 0.0))
    return run_of(tmp_path_factory.mktemp("listed") / "run", wedge(), small)


@pytest.mark.parametrize(
    ("text", "code", "sentence"),
    [
        (BLOCK + WEDGE, 0, "result   pass"),
        (BLOCK + WEDGE + SCREW, 3, "fails: 'screw' is missing"),
        (WEDGE, 3, "fails: part 2 is surplus: "),
        (WEDGE + PLATE, 3, "fails: 'plate' is swapped: part 2 is there instead, "),
        (BLOCK + "count = 2\n" + WEDGE, 3, "fails: 'block' is missing"),
        (BLOCK + 'material = "metal"\n' + WEDGE, 0, "the material of 'block' cannot be determined"),
        (BLOCK + 'material = "gold"\n', 2, "gold"),
        (BLOCK + "colour = 3\n", 2, "unknown key 'item[0].colour'"),
        (BLOCK + BLOCK, 2, "the same name is listed twice"),
        (BLOCK + 'cad = "a.stl"\n', 2, "size_mm or cad must be given"),
        ('[[item]]\nname="a"\ncad="a.stl"\n[[item]]\nname="b"\ncad="a.stl"\n', 2, "CAD file"),
    ],
)
def test_a_list_is_a_verdict_in_sentences(run, tmp_path, capsys, text, code, sentence):
    path = tmp_path / "contents.toml"
    path.write_text(text)
    flags = ["--expect", str(path), "--out", str(tmp_path / "out")]
    assert main(["inspect", str(run), *flags]) == code
    shown = capsys.readouterr()
    assert sentence in shown.out + shown.err
    if code == 2:
        assert len(shown.err.strip().splitlines()) == 1
        assert "item after validation" not in shown.err  # the list has one: its key is wrong
        assert not (tmp_path / "out").exists()


def test_a_list_that_is_not_there_is_one_line(tmp_path):
    with pytest.raises(UserError, match="no such file"):
        read_expected(tmp_path / "none.toml")
