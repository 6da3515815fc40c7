"""The list of contents: CAD models with counts and materials, and lists that are no use."""

import pytest
import trimesh

from geraf2.apps.inspection.bodies import body_of, measure
from geraf2.apps.inspection.expected import (
    ExpectedItem,
    absence_failures,
    material_findings,
    read_expected,
)
from geraf2.apps.inspection.material import Material
from geraf2.apps.inspection.models import model_of
from geraf2.cli.main import main
from helpers.inspected import SMALL, block, few_starts, run_of, wedge


def part(sides_m, kind):
    material = Material(
        kind=kind,
        metal_probability=0.5,
        reflectivity_db=None,
        permittivity=None,
        thickness_m=None,
        n_returns=50,
    )
    return measure(body_of(block(sides_m)), material)


@pytest.mark.parametrize(
    ("kind", "failures", "notes"),
    [
        ("metal", [], []),
        ("plastic", ["'cube' is of plastic, not of metal"], []),
        ("not determined", [], ["the material of 'cube' cannot be determined"]),
    ],
)
def test_the_material_of_a_part_is_compared_with_that_of_its_item(kind, failures, notes):
    item, any_of = (
        ExpectedItem(name="cube", cad="cube.stl", material=material) for material in ("metal", None)
    )
    found = part((0.03,) * 3, kind)
    assert material_findings([(item, found), (any_of, found)]) == (failures, notes)


def test_a_part_of_a_similar_size_in_the_position_of_another_is_one_fault():
    missing = [model_of(block((0.04,) * 3), "cube")]
    parts = [part((0.045, 0.045, 0.01), "plastic"), part((0.01,) * 3, "metal")]
    wanted = "'cube' is swapped: part 1 is there instead, 45 x 45 x 10 mm, plastic"
    assert absence_failures(parts, missing, [0], is_list=True) == [wanted]
    surplus = "part 2 is surplus: 10 x 10 x 10 mm, metal"
    assert absence_failures(parts, missing, [1], is_list=True) == ["'cube' is missing", surplus]
    assert absence_failures(parts, [], [0, 1], is_list=False) == []


def item(name, more=""):
    """Table of a list."""
    return f'[[item]]\nname = "{name}"\ncad = "{name}.stl"\n{more}'


def test_an_item_counts_as_often_as_it_should_be_there(tmp_path):
    (tmp_path / "list.toml").write_text(item("bolt", "count = 2\n") + item("nut"))
    found = read_expected(tmp_path / "list.toml").models
    assert [(one.name, one.cad) for one in found] == [
        ("bolt", str(tmp_path / "bolt.stl")),
        ("bolt", str(tmp_path / "bolt.stl")),
        ("nut", str(tmp_path / "nut.stl")),
    ]


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Run of a wedge and a block, beside the CAD models that lists name."""
    folder = tmp_path_factory.mktemp("listed")
    for name, mesh in (("wedge", wedge()), ("block", SMALL)):
        trimesh.Trimesh(1e3 * mesh.vertices, mesh.faces).export(folder / f"{name}.stl")
    return run_of(folder / "run", wedge(), SMALL)


@pytest.mark.parametrize(
    ("text", "code", "sentence"),
    [
        (item("block", 'material = "metal"\n') + item("wedge"), 0, "the material of 'block'"),
        (item("wedge"), 3, "fails: part 2 is surplus: "),
        (item("block", 'material = "gold"\n'), 2, "gold"),
        (item("block", "colour = 3\n"), 2, "unknown key 'item[0].colour'"),
        (item("block") + item("block"), 2, "the same name is listed twice"),
        (
            item("block") + '[[item]]\nname = "b"\ncad = "block.stl"\n',
            2,
            "CAD file is listed twice",
        ),
        ('[[item]]\nname = "block"\n', 2, "cad"),
        ("", 2, "item"),
        (None, 2, "no such file"),
    ],
)
def test_a_list_is_a_verdict_in_sentences(run, tmp_path, capsys, text, code, sentence):
    path = run.parent / "contents.toml"
    path.unlink(missing_ok=True)
    if text is not None:
        path.write_text(text)
    out = tmp_path / "out"
    with few_starts():
        assert main(["inspect", str(run), "--expect", str(path), "--out", str(out)]) == code
    shown = capsys.readouterr()
    assert sentence in shown.out + shown.err
    if code == 2:
        assert len(shown.err.strip().splitlines()) == 1
        assert not out.exists()
