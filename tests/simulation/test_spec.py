from dataclasses import fields
from pathlib import Path

import pytest

from geraf2.errors import UserError
from geraf2.io.toml import read_table
from geraf2.scene import Wall
from geraf2.simulation import FigureSpec, SceneSpec, WorldSpec, load_spec, parse_spec

CONFIGS = Path(__file__).parents[2] / "configs"


def test_annotated_spec_holds_exactly_the_defaults():
    spec = load_spec(CONFIGS / "simulate.toml")
    walls = (Wall(size_m=(0.22, 0.22, 0.22), thickness_m=0.004, permittivity=1.6),)
    figure = FigureSpec(name="llama")
    assert spec == SceneSpec(figure=figure, walls=walls)
    table = read_table(CONFIGS / "simulate.toml")["world"]
    assert set(table) == {entry.name for entry in fields(WorldSpec)}


def test_mesh_paths_are_relative_to_the_file(tmp_path):
    file = tmp_path / "spec.toml"
    file.write_text(
        '[figure]\nmesh = "things/cup.ply"\n[inside]\nmesh = "key.ply"\n'
        "[world]\nfigure_permittivity = 2.7\nfigure_shell_m = 0.001\n"
    )
    spec = load_spec(file)
    assert spec.figure.mesh == str(tmp_path / "things" / "cup.ply")
    assert spec.inside.mesh == str(tmp_path / "key.ply")


@pytest.mark.parametrize(
    ("table", "named"),
    [
        ({"world": {"figure_shell_m": 0.001}}, "figure_shell_m"),
        ({"inside": {"name": "key"}, "world": {"figure_permittivity": 2.7}}, "inside"),
        (
            {
                "inside": {"name": "key", "roughness_rms_m": 0.001},
                "world": {"figure_permittivity": 2.7, "figure_shell_m": 0.001},
            },
            "roughness_rms_m",
        ),
    ],
)
def test_a_shell_is_of_plastic_and_only_a_shell_holds_something(table, named):
    with pytest.raises(UserError, match=named):
        parse_spec({"figure": {"name": "dog"}, **table}, where="spec.toml")
