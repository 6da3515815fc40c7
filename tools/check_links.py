"""Check that relative links and heading anchors in the Markdown files lead somewhere.

Neither may sources cite pages or headings that are not there: `docs/math/echoes.md#glints`, or
`docs/math/echoes.md, "Glints"`, or in running text (docs/math/echoes.md, glints).

Addresses on the web are left alone: a build must not depend on other people's servers.
"""

import re
import sys
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
LINK = re.compile(r"!?\[[^\]]*\]\(([^)\s]+)\)")
FENCE = re.compile(r"^(```|~~~).*?^\1", re.MULTILINE | re.DOTALL)
HEADING = re.compile(r"^#+\s+(.*)$", re.MULTILINE)
SOURCES = ("python/**/*.py", "tests/**/*.py", "bench/**/*.py", "tools/*.py", "cpp/**/*.[ch]pp")
# A page; then an anchor, titles in quotes, or text that begins with a title.
CITATION = re.compile(
    r"\b(docs/[\w/-]+\.md)(?:#([\w-]+)|, (\"[^\"]+\"(?: and \"[^\"]+\")*)|, ([^)]{1,80}))?"
)
LINE_BREAK = re.compile(r"\n\s*(?:#|//+)?\s*")


def markdown_files() -> list[Path]:
    return sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), *ROOT.glob("*/README.md")])


def anchor_of(title: str) -> str:
    return re.sub(r"[^\w\- ]", "", title.lower()).strip().replace(" ", "-")


@cache
def anchors(path: Path) -> set[str]:
    text = FENCE.sub("", path.read_text(encoding="utf-8"))
    return {anchor_of(title) for title in HEADING.findall(text)}


def broken_links(path: Path) -> list[str]:
    text = FENCE.sub("", path.read_text(encoding="utf-8"))
    broken = []
    for target in LINK.findall(text):
        if re.match(r"[a-z]+:", target):
            continue
        file_part, _, anchor = target.partition("#")
        linked = (path.parent / file_part).resolve() if file_part else path
        if not linked.exists():
            broken.append(f"{path.relative_to(ROOT)}: no such file: {target}")
        elif anchor and linked.suffix == ".md" and anchor not in anchors(linked):
            broken.append(f"{path.relative_to(ROOT)}: no such heading: {target}")
    return broken


def broken_citations(path: Path) -> list[str]:
    text = LINE_BREAK.sub(" ", path.read_text(encoding="utf-8"))
    broken = []
    for page, anchor, titles, words in CITATION.findall(text):
        if not (ROOT / page).exists():
            broken.append(f"{path.relative_to(ROOT)}: no such file: {page}")
            continue
        known = anchors(ROOT / page)
        cited = (
            [anchor] if anchor else [anchor_of(title) for title in titles.split(" and ") if title]
        )
        if words and not any(f"{anchor_of(words)}-".startswith(f"{name}-") for name in known):
            cited = [words]
        broken += [
            f"{path.relative_to(ROOT)}: no such heading: {page}, {name}"
            for name in cited
            if name not in known
        ]
    return broken


def main() -> int:
    sources = sorted(path for pattern in SOURCES for path in ROOT.glob(pattern))
    broken = [line for path in markdown_files() for line in broken_links(path)]
    broken += [line for path in sources for line in broken_citations(path)]
    print("\n".join(broken), end="\n" if broken else "")
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
