"""Formulas of docstrings as SVG, by matplotlib's own TeX: no LaTeX, no script, no network."""

import io
import re
from html import escape
from typing import Any

from docutils import nodes
from matplotlib import mathtext
from matplotlib.font_manager import FontProperties

POINTS = 11.0


def picture(tex: str) -> str:
    """SVG of a formula, in the colour of the text around it."""
    one_line = re.sub(r"\s+", " ", tex.replace(r"\\", " ").replace("&", "")).strip()
    buffer = io.BytesIO()
    mathtext.math_to_image(
        f"${one_line}$", buffer, prop=FontProperties(size=POINTS), format="svg", dpi=72
    )
    svg = buffer.getvalue().decode()
    svg = svg[svg.index("<svg") :]
    # Glyphs are shared by name within a picture; two pictures on a page must not mix them.
    mark = f"f{abs(hash(one_line)):x}"
    svg = re.sub(r'(id="|href="#)([^"]+")', rf"\1{mark}\2", svg)
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.DOTALL)
    svg = re.sub(r'<g id="\w*patch_1">.*?</g>', "", svg, flags=re.DOTALL)
    return svg.replace("<svg ", f'<svg role="img" aria-label="{escape(one_line)}" ', 1)


def inline(writer: Any, node: nodes.math) -> None:
    """Write a formula within a line."""
    writer.body.append(f'<span class="formula">{picture(node.astext())}</span>')
    raise nodes.SkipNode


def block(writer: Any, node: nodes.math_block) -> None:
    """Write a formula on its own."""
    writer.body.append(f'<div class="formula">{picture(node.astext())}</div>')
    raise nodes.SkipNode


def setup(app: Any) -> dict[str, bool]:
    """Register the writer of formulas."""
    app.add_html_math_renderer("svg", (inline, None), (block, None))
    app.config.html_math_renderer = "svg"
    return {"parallel_read_safe": True}
