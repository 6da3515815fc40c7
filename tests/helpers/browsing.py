"""A page in a real browser: sizes of windows, what is drawn."""

import io

import numpy as np
from PIL import Image

DESKTOP, PHONE = (1280, 900), (390, 844)
FLAGS = (
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--no-first-run",
    "--disable-quic",
)


def settle(page):
    """Wait until what was asked for is drawn."""
    page.evaluate("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")


def pixels(page):
    """Read the picture of the view back, (height, width, 3)."""
    shot = page.locator(".viewer canvas").screenshot()
    return np.asarray(Image.open(io.BytesIO(shot)).convert("RGB")).astype(int)  # noqa: TID251 - our own


def serious_findings(page, axe):
    """Names of axe-core's rules that an open page breaks seriously, with all of it unfolded."""
    page.evaluate("document.querySelectorAll('details').forEach(e => { e.open = true })")
    page.evaluate(axe)
    found = page.evaluate("axe.run()")["violations"]
    return [v["id"] for v in found if v["impact"] in ("serious", "critical")]
