"""Parts against a list of contents: counts, materials, and what is missing or swapped."""

from dataclasses import replace

import pytest

from geraf2.apps.inspection.bodies import body_of, measure
from geraf2.apps.inspection.expected import (
    ExpectedItem,
    material_findings,
    read_expected,
)
from geraf2.apps.inspection.material import UNKNOWN
from helpers.inspected import block


def part(sides_m, kind):
    return measure(body_of(block(sides_m)), replace(UNKNOWN, kind=kind))


@pytest.mark.parametrize(
    ("kind", "failures", "notes"),
    [
        ("metal", [], []),
        ("plastic", ["'cube' is of plastic, not of metal"], []),
        ("not determined", [], ["the material of 'cube' cannot be determined"]),
    ],
)
def test_the_material_of_a_part_is_compared_with_that_of_its_item(kind, failures, notes):
    metal, of_any = (
        ExpectedItem(name="cube", cad="cube.stl", material=material) for material in ("metal", None)
    )
    found = part((0.03,) * 3, kind)
    assert material_findings([(metal, found), (of_any, found)]) == (failures, notes)


def test_an_item_counts_as_often_as_it_should_be_there(tmp_path):
    path = tmp_path / "list.toml"
    path.write_text('[[item]]\nname = "bolt"\ncad = "a.stl"\ncount = 2\n')
    assert [(one.name, one.cad) for one in read_expected(path).models] == [
        ("bolt", str(tmp_path / "a.stl"))
    ] * 2
