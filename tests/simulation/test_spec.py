from dataclasses import fields
from importlib.resources import files
from pathlib import Path

import pytest

from geraf2.errors import UserError
from geraf2.io.toml import read_table
from geraf2.scene import Wall
from geraf2.simulation import FigureSpec, PhotosSpec, SceneSpec, WorldSpec, load_spec, parse_spec

CONFIGS = Path(__file__).parents[2] / "configs"


def test_annotated_spec_holds_exactly_the_defaults():
    spec = load_spec(CONFIGS / "simulate.toml")
    walls = (Wall(size_m=(0.22, 0.22, 0.22), thickness_m=0.004, permittivity=1.6),)
    figure = FigureSpec(name="llama")
    assert spec == SceneSpec(figure=figure, walls=walls, photos=PhotosSpec())
    table = read_table(CONFIGS / "simulate.toml")["world"]
    assert set(table) == {entry.name for entry in fields(WorldSpec)}


def test_demo_spec_is_a_figure_in_a_carton():
    spec = load_spec(Path(str(files("geraf2.simulation") / "demo.toml")))
    assert spec.figure.name is not None
    assert all(spec.figure.height_m < min(wall.size_m) for wall in spec.walls)
    assert spec.walls


@pytest.mark.parametrize(
    ("table", "line"),
    [
        (
            {"figure": {"name": "dog", "hight_m": 0.1}},
            "unknown key 'figure.hight_m', did you mean 'height_m'?",
        ),
        ({"figure": {"name": "dog"}, "noise": {}}, "unknown key 'noise'"),
        (
            {"figure": {"name": "dog"}, "scan": {"spacing": 1}},
            "unknown key 'scan.spacing', did you mean 'spacing_m'?",
        ),
        (
            {"figure": {"name": "dog"}, "walls": [{"size_m": [1, 1, 1], "eps": 2}]},
            "unknown key 'walls[0].eps'",
        ),
        ({"figure": {}}, "spec.toml: figure needs either name or mesh"),
        ({}, "key 'figure' is missing"),
    ],
)
def test_a_bad_key_or_value_is_one_clear_line(table, line):
    with pytest.raises(UserError) as error:
        parse_spec(table, where="spec.toml")
    text = str(error.value)
    assert line in text
    assert text.startswith("spec.toml: ")
    assert "\n" not in text


def test_mesh_paths_are_relative_to_the_file(tmp_path):
    file = tmp_path / "spec.toml"
    file.write_text('[figure]\nmesh = "things/cup.ply"\n')
    assert load_spec(file).figure.mesh == str(tmp_path / "things" / "cup.ply")
