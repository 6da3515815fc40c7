"""Check the site that `make docs` built: names, links, search, and that it asks no other server.

    python tools/check_docs.py build/docs

Every public name has a page with an example, every link between pages and headings leads
somewhere, nothing is loaded from the network, and the search knows what people look for.
"""

import json
import re
import sys
from functools import cache
from html import unescape
from pathlib import Path
from urllib.parse import unquote

import geraf2

LINK = re.compile(r'<a\b[^>]*?\bhref="([^"]+)"')
LOADED = re.compile(r'<(?:script|img|link|iframe|source)\b[^>]*?\b(?:src|href)="(https?://[^"]+)"')
NAME = re.compile(r'\b(?:id|name)="([^"]+)"')
SEARCHED = ("phase sign", "delay", "ghost", "glint", "leakage")


@cache
def text_of(path: Path) -> str:
    return path.read_text(encoding="utf-8")


@cache
def anchors(path: Path) -> frozenset[str]:
    return frozenset(map(unescape, NAME.findall(text_of(path))))


def broken_links(path: Path, site: Path) -> list[str]:
    broken = []
    for target in map(unescape, set(LINK.findall(text_of(path)))):
        if re.match(r"[a-z]+:", target):
            continue
        file_part, _, anchor = unquote(target).partition("#")
        linked = (path.parent / file_part.partition("?")[0]).resolve() if file_part else path
        where = f"{path.relative_to(site)}: "
        if not linked.exists():
            broken.append(f"{where}no such file: {target}")
        elif anchor and linked.suffix == ".html" and anchor not in anchors(linked):
            broken.append(f"{where}no such heading: {target}")
    return broken


def missing_names(site: Path) -> list[str]:
    missing = []
    for name in geraf2.__all__:
        page = site / "generated" / "api" / f"geraf2.{name}.html"
        if name == "__version__":
            continue
        if not page.exists():
            missing.append(f"no page of geraf2.{name}")
        elif "&gt;&gt;&gt;" not in text_of(page) and "alias of" not in text_of(page):
            missing.append(f"no example on the page of geraf2.{name}")
    return missing


def found_by_search(words: str, index: dict) -> list[str]:
    """Pages that the site's search has for all of the words, as its script looks them up."""
    pages: set[int] | None = None
    for word in re.findall(r"\w+", words.lower()):
        here = set()
        for kind in ("terms", "titleterms"):
            for term, found in index[kind].items():
                if term == word or (len(word) > 3 and term.startswith(word[:-1])):
                    here |= set(found if isinstance(found, list) else [found])
        pages = here if pages is None else pages & here
    return [index["docnames"][number] for number in sorted(pages or ())]


def main() -> int:
    site = Path(sys.argv[1]).resolve()
    pages = sorted(path for path in site.rglob("*.html") if "_static" not in path.parts)
    wrong = missing_names(site)
    for page in pages:
        wrong += broken_links(page, site)
        wrong += [
            f"{page.relative_to(site)}: loads {address}"
            for address in LOADED.findall(text_of(page))
        ]
    written = text_of(site / "searchindex.js")
    index = json.loads(written[written.index("(") + 1 : written.rindex(")")])
    wrong += [f"a search does not find {w!r}" for w in SEARCHED if not found_by_search(w, index)]
    print("\n".join(wrong), end="\n" if wrong else "")
    print(f"{len(pages)} pages, {len(geraf2.__all__) - 1} public names, {len(wrong)} faults")
    return 1 if wrong or not pages else 0


if __name__ == "__main__":
    sys.exit(main())
