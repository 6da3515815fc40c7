import math
from dataclasses import dataclass, field, fields, is_dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from geraf2.apps.photos.config import PhotoConfig
from geraf2.calibration.driver import CalibrationConfig
from geraf2.errors import UserError
from geraf2.io.manifest import RadarManifest
from geraf2.io.toml import from_table, read_toml, to_table, write_toml
from geraf2.pipeline.presets import PRESETS
from geraf2.pipeline.prior import PriorSource
from geraf2.pipeline.run_record import RunOptions
from geraf2.simulation import DisturbanceSpec, FigureSpec, SceneSpec
from geraf2.surfaces.config import SurfaceFitConfig

CONFIGS = [
    *(kind() for kind in PRESETS.values()),
    PriorSource(los=Path("a b/los.ply")),
    RunOptions(hold_out=(0.0, 1e-300)),
    CalibrationConfig(),
    PhotoConfig(),
    SurfaceFitConfig(),
    SceneSpec(
        figure=FigureSpec(name="dog"),
        disturbance=DisturbanceSpec(snr_db=math.inf),
    ),
    RadarManifest(start_frequency_hz=77e9, arrays={"signal": "rx"}),
]


def moved(value: Any) -> Any:
    """The same record with all numbers at their last bit."""
    if not is_dataclass(value):
        return math.nextafter(value, math.inf) if isinstance(value, float) else value
    changes = {e.name: moved(getattr(value, e.name)) for e in fields(value)}
    try:
        return replace(value, **changes)
    except ValueError:  # some stand at the end of what is allowed
        return value


@pytest.mark.parametrize(
    "config", CONFIGS, ids=lambda c: f"{type(c).__module__}.{type(c).__name__}"
)
def test_what_is_written_is_read_again(tmp_path, config):
    for value in (config, moved(config)):
        write_toml(tmp_path / "config.toml", value)
        assert read_toml(tmp_path / "config.toml", type(config)) == value


@dataclass(frozen=True, kw_only=True)
class Inner:
    n_steps: int = 3
    rate: float = 0.5
    side_m: tuple[float, float] = (1.0, 2.0)

    def __post_init__(self):
        if self.n_steps < 1:
            msg = f"n_steps must be at least 1, got {self.n_steps}"
            raise ValueError(msg)


@dataclass(frozen=True, kw_only=True)
class Fine:
    preset: Literal["fine"] = "fine"
    inner: Annotated[Inner, "a note"] = field(default_factory=Inner)
    fine: Inner | None = None
    """Called as the preset is."""
    steps: tuple[Inner, ...] = ()
    known: float | Literal["true"] = "true"
    where: Path | None = None
    named: dict[str, tuple[int, ...]] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class Coarse:
    preset: Literal["coarse", "coarser"] = "coarse"
    sign: bool = False
    text: str


inners = st.builds(
    Inner,
    n_steps=st.integers(1, 2**62),
    rate=st.floats(allow_nan=False),
    side_m=st.tuples(st.floats(allow_nan=False), st.floats(allow_nan=False)),
)
texts = st.text(st.characters(exclude_categories=["Cs"]))


@settings(deadline=None)
@given(
    st.builds(
        Fine,
        preset=st.just("fine"),
        inner=inners,
        fine=st.none() | inners,
        steps=st.lists(inners, max_size=3).map(tuple),
        known=st.just("true") | st.floats(0, 1),
        where=st.none() | st.just(Path("a/b")),
        named=st.dictionaries(texts, st.lists(st.integers(-9, 9)).map(tuple), max_size=3),
    )
    | st.builds(Coarse, preset=st.sampled_from(["coarse", "coarser"]), text=texts)
)
def test_a_table_holds_its_type(record):
    assert from_table(to_table(record), (Fine, Coarse), "x") == record


@pytest.mark.parametrize(
    ("table", "line"),
    [
        ({"inner": {"n_steps": 1.0}}, "inner.n_steps': input should be a valid integer, got 1"),
        ({"inner": {"rate": True}}, "key 'inner.rate': input should be a valid number, got True"),
        ({"inner": {"n_steps": 0}}, "inner.n_steps must be at least 1, got 0"),
        ({"inner": {"side_m": [1.0]}}, "key 'inner.side_m[1]' is missing"),
        ({"inner": 3}, "key 'inner': input should be an object, got 3"),
        ({"fine": {"n_step": 1}}, "unknown key 'fine.n_step', did you mean 'n_steps'?"),
        ({"steps": [{}, {"rat": 1}]}, "unknown key 'steps[1].rat', did you mean 'rate'?"),
        ({"steps": [{}, {"n_steps": -1}]}, "steps[1].n_steps must be at least 1, got -1"),
        ({"known": "false"}, "key 'known': input should be 'true', got 'false'"),
        ({"preset": "coarse"}, "key 'text' is missing"),
        ({"preset": "coarse", "text": "", "sign": 1}, "key 'sign': input should be a valid bool"),
        ({"preset": "coarsest"}, "unknown name 'coarsest', did you mean 'coarse"),
        ({"preset": 3}, "key 'preset': unknown name 3, expected one of fine, coarse, coarser"),
        ({"preset": None}, "key 'preset' is missing, expected one of fine, coarse, coarser"),
    ],
)
def test_a_wrong_table_is_one_line_that_names_the_key(table, line):
    table = {"preset": "fine", **table}
    table = {key: value for key, value in table.items() if value is not None}
    with pytest.raises(UserError) as error:
        from_table(table, (Fine, Coarse), "config.toml")
    assert line in str(error.value)
    assert str(error.value).startswith("config.toml: ")
