"""HTML pages in one file, from the jinja2 templates of `templates/`, without network."""

import base64
import json
from collections.abc import Container, Mapping
from functools import cache
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

from geraf2 import __version__
from geraf2._types import AnyPath
from geraf2.io.regular import BINARY_BYTES, read_regular

if TYPE_CHECKING:
    from jinja2 import Environment

_TEMPLATES = Path(__file__).parent / "templates"
_SCRIPTS = Path(__file__).parent / "viewer"
# Of pictures in pages: a third of the bytes of PNG, lines and letters still sharp.
_QUALITY = 88


@cache
def _environment() -> "Environment":
    from jinja2 import Environment, FileSystemLoader, StrictUndefined  # noqa: PLC0415 - takes 0.1 s

    environment = Environment(
        loader=FileSystemLoader((_TEMPLATES, _SCRIPTS)),
        autoescape=lambda name: name is None or not name.endswith(".md"),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["mm"] = _millimetres
    environment.globals["zip"] = zip
    return environment


def rendered(template: str, **context: Any) -> str:
    """Render a template."""
    return _environment().get_template(template).render(version=__version__, **context)


def part(name: str, *arguments: Any, **named: Any) -> str:
    """HTML of a macro of `parts.html`, which templates do not escape."""
    from markupsafe import Markup  # noqa: PLC0415 - as above

    macro = getattr(_environment().get_template("parts.html").module, name)
    return Markup(str(macro(*arguments, **named)).strip())


def picture(
    path: AnyPath, caption: str = "", *, name: str = "", max_width_px: int | None = None
) -> str:
    """Embedded picture; `name` of one whose description `parts.html` has."""
    return part("picture", _source(path), caption, name, max_width_px)


def _source(path: AnyPath) -> str:
    """Return the data URL of a picture, as WebP where Pillow supports it and it is smaller."""
    from PIL import features  # noqa: PLC0415 - takes 0.1 s

    from geraf2.io.pictures import opened_picture  # noqa: PLC0415 - as above

    kind, data = "png", read_regular(path, BINARY_BYTES)
    if features.check("webp"):
        stream = BytesIO()
        with opened_picture(Path(path)) as image:
            image.convert("RGB").save(stream, format="WEBP", quality=_QUALITY, method=2)
        if stream.tell() < len(data):
            kind, data = "webp", stream.getvalue()
    return f"data:image/{kind};base64,{base64.b64encode(data).decode('ascii')}"


def _millimetres(value_m: float | None) -> str:
    """Length in mm with two decimals; n/a for None."""
    return "n/a" if value_m is None else f"{1e3 * value_m:.2f}"


def scalar_rows(values: Mapping[str, Any], skip: Container[str] = ()) -> list[tuple[str, str]]:
    """Plain values of a mapping as rows of text, nested ones by dotted name."""
    rows: list[tuple[str, str]] = []
    for key, value in values.items():
        if key in skip or value is None:
            continue
        if isinstance(value, Mapping):
            rows += [(f"{key}.{name}", text) for name, text in scalar_rows(value)]
        elif isinstance(value, float):
            rows.append((key, f"{value:.6g}"))
        elif isinstance(value, str | int | bool):
            rows.append((key, str(value)))
        else:
            rows.append((key, json.dumps(value)))
    return rows
