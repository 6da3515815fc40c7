"""Refuse the words of tools/words.toml in documentation, docstrings, comments and messages.

    python tools/check_words.py               # file:line: word -> what to write instead
    python tools/check_words.py --list        # what would have to be exempt, for words.toml
    python tools/check_words.py --sentences   # also report sentences that are too long

It reads the pages, docs/reference/causes.toml, and the comments and strings of the package, cpp,
tests, bench, examples, tools and the gallery, and the names that Python code defines. A string
without a space is no message. The lengths of pages and of the whole site are limited as well.
"""

import argparse
import ast
import io
import re
import sys
import tokenize
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PAGES = ("*.md", "docs/**/*.md", "docs/**/*.rst", "docs/reference/*.toml")
SOURCES = (
    "python/geraf2/**/*.py",
    "bench/**/*.py",
    "examples/*.py",
    "tests/**/*.py",
    "tools/*.py",
    "docs/gallery/*.py",
    "cpp/**/*.cpp",
    "cpp/**/*.hpp",
)
NO_PAGE = ("docs/generated/", "docs/_", "docs/gallery/")
"""Parts of docs/ that are not pages: what a build of the site wrote, templates, scripts."""
BUILT = NO_PAGE[:2]
FENCE = re.compile(r"^(```|~~~).*?^\1", re.MULTILINE | re.DOTALL)
CODE = re.compile(r"``[^`]+``|`[^`\n]+`|\]\([^)\s]*\)|<[^>\s]+>|^(?: {4}|\t).*$", re.MULTILINE)
QUOTED = re.compile(r"``[^`]+``|`[^`\n]+`")
NO_PROSE = re.compile(r"^(?!cause = |do = |#).*$", re.MULTILINE)
"""Lines of docs/reference/causes.toml that quote the program's messages."""
CPP = re.compile(r'//[^\n]*|/\*.*?\*/|"(?:[^"\\\n]|\\.)*"', re.DOTALL)
SENTENCE_END = re.compile(r"(?<=[.!?:;])\s+|\n\s*\n|\n\s*(?=[-*|#\d])")


@dataclass(frozen=True, kw_only=True)
class Rule:
    """A word that is refused."""

    refuse: re.Pattern[str]
    instead: str
    allow: tuple[re.Pattern[str], ...]
    not_in: tuple[str, ...]
    """Beginnings of the names of files in which the word has its usual sense."""
    names: bool
    """Whether names of Python code must not contain it either."""

    def matches(self, text: str) -> Iterator[re.Match[str]]:
        """Matches that no allowed phrase contains."""
        allowed = [m.span() for pattern in self.allow for m in pattern.finditer(text)]
        for match in self.refuse.finditer(text):
            if not any(a <= match.start() and match.end() <= b for a, b in allowed):
                yield match


@dataclass(frozen=True, kw_only=True)
class Table:
    """The content of words.toml."""

    rules: tuple[Rule, ...]
    page_words: int
    site_words: int
    sentence_words: int
    exempt_words: tuple[str, ...]
    exempt_pages: tuple[str, ...]

    @classmethod
    def read(cls, path: Path) -> "Table":
        table = tomllib.loads(path.read_text(encoding="utf-8"))
        rules = tuple(
            Rule(
                refuse=_compiled(word["refuse"]),
                instead=word["instead"],
                allow=tuple(map(_compiled, word.get("allow", ()))),
                not_in=tuple(word.get("not_in", ())),
                names=word.get("names", True),
            )
            for word in table["word"]
        )
        exempt = table["exempt"]
        return cls(
            rules=rules,
            **table["limits"],
            exempt_words=tuple(exempt["words"]),
            exempt_pages=tuple(exempt["pages"]),
        )


def _compiled(pattern: str) -> re.Pattern[str]:
    return re.compile(pattern.replace(" ", r"\s+"), re.IGNORECASE)


def _blank(match: re.Match[str]) -> str:
    """The lines of a match, without their text."""
    return re.sub(r"[^\n]", " ", match.group())


def prose_of_page(text: str) -> Iterator[tuple[int, str]]:
    """First line and text of a page, its code left blank."""
    yield 1, CODE.sub(_blank, FENCE.sub(_blank, text))


def prose_of_python(text: str) -> Iterator[tuple[int, str]]:
    """First line and text of each string with a space, and of each block of comments."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and " " in node.value:
            examples = re.sub(r"^ *(?:>>>|\.\.\.).*$", "", node.value, flags=re.MULTILINE)
            yield node.lineno, QUOTED.sub(_blank, examples)
    first, block = 0, ""
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type != tokenize.COMMENT:
            continue
        line = token.start[0]
        if block and line == first + block.count("\n"):
            block += token.string.lstrip("#") + "\n"
            continue
        if block:
            yield first, block
        first, block = line, token.string.lstrip("#") + "\n"
    if block:
        yield first, block


def names_of_python(text: str) -> Iterator[tuple[int, str]]:
    """Line and words of each name that a module defines: `two_way_m` is "two-way m"."""
    for node in ast.walk(ast.parse(text)):
        name = ""
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            name = node.name
        elif isinstance(node, ast.arg):
            name = node.arg
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            name = node.id
        elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
            name = node.attr
        if name:
            words = re.sub(r"(?<=[a-z0-9])(?=[A-Z])|_", " ", name)
            yield node.lineno, re.sub(r"\b(one|two) (?=wa)", r"\1-", words, flags=re.IGNORECASE)


def prose_of_cpp(text: str) -> Iterator[tuple[int, str]]:
    """First line and text of each comment and string; neighbouring comment lines are one text."""
    first, block = 0, ""
    for match in CPP.finditer(text):
        line = text.count("\n", 0, match.start()) + 1
        words = match.group().strip('/*"')
        if match.group().startswith("//"):
            if block and line == first + block.count("\n"):
                block += words + "\n"
                continue
            if block:
                yield first, QUOTED.sub(_blank, block)
            first, block = line, words + "\n"
        elif " " in words:
            yield line, QUOTED.sub(_blank, words)
    if block:
        yield first, QUOTED.sub(_blank, block)


def prose_of(path: Path) -> Iterator[tuple[int, str]]:
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".py":
        return prose_of_python(text)
    if path.suffix in {".cpp", ".hpp"}:
        return prose_of_cpp(text)
    return prose_of_page(NO_PROSE.sub(_blank, text) if path.suffix == ".toml" else text)


def refused_words(name: str, path: Path, table: Table) -> list[str]:
    """Faults of a file without its name: `line: word -> instead`, in order."""
    rules = [rule for rule in table.rules if not name.startswith(rule.not_in)]
    texts = [(first, text, rules) for first, text in prose_of(path)]
    if path.suffix == ".py":
        of_names = [rule for rule in rules if rule.names]
        names = names_of_python(path.read_text(encoding="utf-8"))
        texts += [(first, text, of_names) for first, text in names]
    found = set()
    for first, text, applied in texts:
        for rule in applied:
            for match in rule.matches(text):
                word = " ".join(match.group().split())
                line = first + text.count("\n", 0, match.start())
                found.add((line, f"{line}: {word} -> {rule.instead}"))
    return [fault for _, fault in sorted(found)]


def long_sentences(path: Path, n_words: int) -> list[str]:
    found = []
    for first, text in prose_of(path):
        start = 0
        for sentence in SENTENCE_END.split(text):
            at = text.index(sentence, start)
            start = at + len(sentence)
            n = len(re.findall(r"[^\W_][\w'.-]*", sentence))
            if n > n_words and "|" not in sentence:
                begin = " ".join(sentence.split()[:6])
                line = first + text.count("\n", 0, at)
                found.append(f"{line}: {n} words in a sentence: {begin} ...")
    return found


def files(root: Path, patterns: tuple[str, ...]) -> dict[str, Path]:
    """Files by their name below the root, without what a build of the site wrote."""
    found = {p.relative_to(root).as_posix(): p for pattern in patterns for p in root.glob(pattern)}
    return {name: path for name, path in sorted(found.items()) if not name.startswith(BUILT)}


def page_lengths(root: Path) -> dict[str, int]:
    """Words of each page of the site, as `wc -w` counts them."""
    pages = files(root, ("docs/**/*.md", "docs/**/*.rst"))
    return {
        name: len(path.read_text(encoding="utf-8").split())
        for name, path in pages.items()
        if not name.startswith(NO_PAGE)
    }


def faults(root: Path, table: Table) -> list[str]:
    """Everything that is refused, and entries of the exempt lists that nothing needs."""
    found: list[str] = []
    idle = set(table.exempt_words)
    for name, path in files(root, PAGES + SOURCES).items():
        words = refused_words(name, path, table)
        exempt = {entry for entry in table.exempt_words if name.startswith(entry)}
        if words:
            idle -= exempt
        found += [] if exempt else [f"{name}:{fault}" for fault in words]
    lengths = page_lengths(root)
    for name, n in lengths.items():
        if n > table.page_words and name not in table.exempt_pages:
            found.append(f"{name}: {n} words, limit {table.page_words}: split or shorten it")
    n_site = sum(n for name, n in lengths.items() if name not in table.exempt_pages)
    if n_site > table.site_words:
        found.append(f"docs: {n_site} words on all pages, limit {table.site_words}")
    idle |= {name for name in table.exempt_pages if lengths.get(name, 0) <= table.page_words}
    found += [f"tools/words.toml: {entry} has no fault: it must leave the list" for entry in idle]
    return found


def needed(root: Path, table: Table) -> str:
    """The exempt lists that would let everything pass, in the form of words.toml."""
    words = set()
    for name, path in files(root, PAGES + SOURCES).items():
        if refused_words(name, path, table):
            parts = Path(name).parts
            depth = 4 if "apps" in parts else 3  # a room of the package, or an application
            in_room = parts[0] == "python" and len(parts) > depth
            words.add("/".join(parts[:depth]) + "/" if in_room else name)
    pages = [name for name, n in page_lengths(root).items() if n > table.page_words]
    lists = {"words": sorted(words), "pages": sorted(pages)}
    return "\n".join(
        f"{key} = [\n" + "".join(f'  "{name}",\n' for name in names) + "]"
        for key, names in lists.items()
    )


def main(arguments: list[str] | None = None, root: Path = ROOT) -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--list", action="store_true", help="print the lists of words.toml")
    parser.add_argument("--sentences", action="store_true", help="report long sentences of pages")
    options = parser.parse_args(arguments)
    table = Table.read(root / "tools" / "words.toml")
    if options.list:
        print(needed(root, table))
        return 0
    if options.sentences:
        for name, path in files(root, PAGES).items():
            for line in long_sentences(path, table.sentence_words):
                print(f"{name}:{line}")
    found = faults(root, table)
    print("\n".join(found), end="\n" if found else "")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
