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
from geraf2.io.text import parse_json
from geraf2.report.canvas import PANELS_KEY

if TYPE_CHECKING:
    from jinja2 import Environment
    from PIL.Image import Image

_TEMPLATES = Path(__file__).parent / "templates"
_SCRIPTS = Path(__file__).parent / "viewer"
# Of pictures in pages: a third of the bytes of PNG, lines and letters still sharp.
_QUALITY = 88
_TIGHT = (
    ("+- ", "\u00b1\u00a0"),
    (" \u00b1 ", "\u00a0\u00b1\u00a0"),
    (" %", "\u00a0%"),
    (" mm", "\u00a0mm"),
    (" x ", "\u00a0\u00d7 "),
    ("cm^3", "cm\u00b3"),
)


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
    environment.filters["tight"] = _bind_units
    environment.globals["zip"] = zip
    return environment


def render_template(template: str, **context: Any) -> str:
    """Render a template."""
    return _environment().get_template(template).render(version=__version__, **context)


def part(name: str, *arguments: Any, **named: Any) -> str:
    """HTML of a macro of `parts.html`, which templates do not escape."""
    from markupsafe import Markup  # noqa: PLC0415 - as above

    macro = getattr(_environment().get_template("parts.html").module, name)
    return Markup(str(macro(*arguments, **named)).strip())


def picture(path: AnyPath, caption: str = "", *, name: str = "") -> str:
    """Embedded picture, in panels where it has some; `parts.html` describes those with a name."""
    from geraf2.io.pictures import open_picture  # noqa: PLC0415 - takes 0.1 s

    with open_picture(Path(path)) as image:
        about = _panels_of(image)
        shown = image.convert("RGB")
    rows = [
        [{"source": picture_source(shown.crop(box)), "width": box[2] - box[0]} for box in row]
        for row in about["rows"]
    ]
    return part("picture", rows, about["letters"], shown.width, caption, name)


def _panels_of(image: "Image") -> dict[str, Any]:
    """Rows of boxes of a picture, and the height of its letters [px], from `canvas.Sheet`."""
    whole = {"rows": [[[0, 0, image.width, image.height]]], "letters": None}
    try:
        kept = parse_json(image.info.get(PANELS_KEY, "null"))
        boxes = [box for row in kept["rows"] for box in row]
        good = kept["letters"] > 0 and all(
            0 <= x0 < x1 <= image.width and 0 <= y0 < y1 <= image.height for x0, y0, x1, y1 in boxes
        )
    except (ValueError, TypeError, KeyError):  # of another program, or of an earlier version
        return whole
    return kept if good and boxes else whole


def picture_source(image: "Image") -> str:
    """Return the data URL of a picture, as WebP where Pillow supports it."""
    from PIL import features  # noqa: PLC0415 - takes 0.1 s

    kind, stream = "webp" if features.check("webp") else "png", BytesIO()
    image.save(stream, format=kind.upper(), quality=_QUALITY, method=2)
    return f"data:image/{kind};base64,{base64.b64encode(stream.getvalue()).decode('ascii')}"


def _millimetres(value_m: float | None) -> str:
    """Length in mm with two decimals; n/a for None."""
    return "n/a" if value_m is None else f"{1e3 * value_m:z.2f}"


def _bind_units(text: str) -> str:
    """Text without line breaks between numbers and units."""
    for loose, tight in _TIGHT:
        text = text.replace(loose, tight)
    return text


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
