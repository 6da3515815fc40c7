"""Parts against a list of contents: counts, materials, and what is missing or swapped."""

from dataclasses import replace

import pytest

from geraf2.apps.inspection.bodies import body_of, measure
from geraf2.apps.inspection.expected import (
    ExpectedItem,
    absence_failures,
    material_findings,
    read_expected,
)
from geraf2.apps.inspection.material import UNKNOWN
from geraf2.apps.inspection.models import model_of
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


def test_a_part_of_a_similar_size_in_the_position_of_another_is_one_fault():
    missing = [model_of(block((0.04,) * 3), "cube")]
    parts = [part((0.045, 0.045, 0.01), "plastic"), part((0.01,) * 3, "metal")]
    wanted = "'cube' is swapped: part 1 is there instead, 45 x 45 x 10 mm, plastic"
    assert absence_failures(parts, missing, [0], is_list=True) == [wanted]
    surplus = "part 2 is surplus: 10 x 10 x 10 mm, metal"
    assert absence_failures(parts, missing, [1], is_list=True) == ["'cube' is missing", surplus]
    assert absence_failures(parts, [], [0, 1], is_list=False) == []


def test_an_item_counts_as_often_as_it_should_be_there(tmp_path):
    path = tmp_path / "list.toml"
    path.write_text('[[item]]\nname = "bolt"\ncad = "a.stl"\ncount = 2\n')
    assert [(one.name, one.cad) for one in read_expected(path).models] == [
        ("bolt", str(tmp_path / "a.stl"))
    ] * 2
