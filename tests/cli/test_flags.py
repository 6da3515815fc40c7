from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import pytest

from geraf2._bounds import Arg
from geraf2.cli._fields import Positional
from geraf2.cli._flags import help_text, parse
from geraf2.errors import UserError, speaking_of_flags


@dataclass(frozen=True, kw_only=True)
class Rim:
    size_m: float = 0.1
    """Width of the rim [m]. A second sentence."""
    shadows: bool = True
    """Leave the shadows out."""

    def __post_init__(self):
        if self.size_m <= 0:
            msg = f"size_m must be positive, got {self.size_m}"
            raise ValueError(msg)


@dataclass(frozen=True, kw_only=True)
class Coarse:
    n_cells: int = 8


@dataclass(frozen=True, kw_only=True)
class Inner:
    rim: Rim = field(default_factory=Rim)
    """The rim."""
    levels: tuple[int, ...] = (1, 2)


@dataclass(frozen=True, kw_only=True)
class Settings:
    scene: Positional[Annotated[Path, Arg(metavar="SCENE")]]
    """Scene folder."""
    out: Positional[Annotated[Path | None, Arg(metavar="[OUT]")]] = None
    box: Annotated[tuple[float, float, float] | None, Arg(metavar="X Y Z")] = None
    """Sides of the box,
    in metres [m]."""
    mode: Literal["near", "far"] | Literal["both"] = "near"  # noqa: PYI030 - as unions of them are
    seed: int = 0
    count: int | None = None
    resume: bool = False
    inner: Inner = field(default_factory=Inner)
    open: Annotated[Inner, Arg(name="")] = field(default_factory=Inner)
    constants: Annotated[Rim | Coarse, Arg(hidden=True)] = field(default_factory=Rim)
    """Constants."""


def read(*arguments, **more):
    return parse(Settings, arguments, prog="tool", **more)


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ([], {}),
        (["b"], {"out": Path("b")}),
        (["--box", "-1", "-1e-3", "-inf"], {"box": (-1.0, -0.001, float("-inf"))}),
        (["--box", "1", "1", "1", "--box", "None"], {}),
        (["--count", "3", "--count=4"], {"count": 4}),
        (["--mode", "both", "--resume"], {"mode": "both", "resume": True}),
        (["--inner.levels"], {"inner": Inner(levels=())}),
        (["--inner.levels", "3", "--seed", "1"], {"inner": Inner(levels=(3,)), "seed": 1}),
        (["--inner.rim.size_m", "2"], {"inner": Inner(rim=Rim(size_m=2.0))}),
        (["--rim.no-shadows"], {"open": Inner(rim=Rim(shadows=False))}),
        (["--constants.size-m", "3"], {"constants": Rim(size_m=3.0)}),
    ],
)
def test_a_flag_sets_its_field_and_no_other(arguments, expected):
    assert read("a", *arguments) == Settings(scene=Path("a"), **expected)


def test_flags_may_come_first_and_defaults_may_be_others():
    given = read("--seed", "2", "a", "--resume", "b")
    assert given == Settings(scene=Path("a"), out=Path("b"), seed=2, resume=True)
    changed = read("a", "--constants.n-cells", "9", default={"constants": Coarse(), "seed": 3})
    assert changed == Settings(scene=Path("a"), constants=Coarse(n_cells=9), seed=3)
    assert read("--resume", default=changed).constants == Coarse(n_cells=9)


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (["a", "b", "c"], "unexpected argument 'c'"),
        (["a", "--size-m", "1"], "unknown flag --size-m (did you mean --inner.rim.size-m FLOAT or"),
        (["a", "--sead", "1"], "unknown flag --sead (did you mean --seed INT?)"),
        (["a", "--resume=yes"], "--resume takes no value, got 'yes'"),
        (["a", "--mode", "nar"], "expected {near,far,both}, got 'nar' (did you mean near?)"),
        (["a", "--box", "1", "2"], "--box: needs 3 values, expected X Y Z, got 1 2"),
    ],
)
def test_what_does_not_fit_is_one_line(arguments, line):
    with speaking_of_flags(), pytest.raises(UserError) as caught:
        read(*arguments)
    with speaking_of_flags():
        text = str(caught.value)
    assert line in text
    assert text.endswith("; see 'tool --help'")
    assert "\n" not in text


def test_help_shows_flags_values_docstrings_and_defaults_but_no_hidden_group(capsys):
    with pytest.raises(SystemExit) as caught:
        read("--help", description="What it does.")
    assert caught.value.code == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[:3] == ["usage: tool SCENE [OUT] [FLAGS]", "", "What it does."]
    at = lines.index("  --box X Y Z")
    assert lines[at + 1] == "      Sides of the box, in metres [m]."
    assert lines[lines.index("  --seed INT") + 1] == "      (default: 0)"
    assert "--inner.rim: The rim:" in lines
    assert "  --inner.rim.no-shadows" in lines
    assert not any("constants" in line for line in lines)
    hidden = help_text(Settings, prog="tool", hidden=True)
    assert "  --constants.size-m FLOAT\n      Width of the rim [m]. (default: 0.1)\n" in hidden
    assert "--seed" not in hidden
