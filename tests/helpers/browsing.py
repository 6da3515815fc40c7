"""A page in a real browser: sizes of windows, what is drawn."""

import io

import numpy as np
from PIL import Image

DESKTOP, PHONE = (1440, 900), (390, 844)
SCREENS = [(DESKTOP, False), (PHONE, True)]
"""Both sizes and both themes."""
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


def pixels(page, part=".viewer canvas"):
    """Read the picture of the view, or of a part of the page, back, (height, width, 3)."""
    shot = page.locator(part).screenshot()
    return np.asarray(Image.open(io.BytesIO(shot)).convert("RGB")).astype(int)  # noqa: TID251 - our own


def serious_findings(page, axe):
    """Names of axe-core's rules that an open page breaks seriously, with all of it unfolded."""
    page.evaluate("document.querySelectorAll('details').forEach(e => { e.open = true })")
    page.evaluate(axe)
    how = {"resultTypes": ["violations"], "selectors": False}
    found = page.evaluate("how => axe.run(document, how)", how)["violations"]
    return [v["id"] for v in found if v["impact"] in ("serious", "critical")]


# Texts with letters below 11 px: of elements, and of pictures whose letters have a known height.
_SMALL = """() => {
  document.querySelectorAll("details").forEach((e) => { e.open = true; });
  const found = [];
  for (const e of document.querySelectorAll("body *")) {
    const own = [...e.childNodes].some((n) => n.nodeType === 3 && n.textContent.trim());
    const seen = e.getClientRects().length && !["SCRIPT", "STYLE", "OPTION"].includes(e.tagName);
    const height = e.dataset.letters ? e.dataset.letters * e.clientWidth : 11;
    if (own && seen && parseFloat(getComputedStyle(e).fontSize) < 11) found.push(e.textContent);
    if (height < 11) found.push(e.alt || e.tagName);
  }
  return found;
}"""


def require_readable(page, size):
    """Assert that a page fits its window, and that no letter is smaller than 11 px."""
    assert page.evaluate(_SMALL) == []
    assert page.evaluate("document.documentElement.scrollWidth") <= size[0]


def require_sound(page, url, size, axe):
    """Assert that a page with a view works, asks for nothing, is readable and accessible."""
    assert page.locator(".viewer.works").count() == 1
    assert page.trouble == []
    assert [one for one in page.requests if not one.startswith("data:")] == [url]
    require_first_screen(page, size, ".hero .lead")
    require_readable(page, size)
    assert serious_findings(page, axe) == []


def hidden_share(page, label):
    """Share of the view's pixels that change when a layer is hidden."""
    drawn = pixels(page)
    page.locator(".viewer").get_by_label(label, exact=True).uncheck()
    settle(page)
    return (np.abs(pixels(page) - drawn).max(axis=2) > 5).mean()


def require_first_screen(page, size, verdict):
    """Assert that the 3D view and the verdict are on the screen before any scrolling."""
    stage = page.locator(".viewer .stage").bounding_box()
    shown = min(stage["y"] + stage["height"], size[1]) - stage["y"]
    assert shown > 0.8 * stage["height"], (stage, page.locator(".hero").inner_text())
    text = page.locator(verdict).bounding_box()
    assert text["y"] >= 0
    assert text["y"] + text["height"] <= size[1]
