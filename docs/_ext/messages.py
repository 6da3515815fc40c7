"""Every warning and error of the package, collected from its code, as pages."""

import ast
import re
import tomllib
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[2] / "python" / "geraf2"
CAUSES = "reference/causes.toml"
# Package or application, and what its messages are about.
AREAS = {
    "io": "Files",
    "scene": "Scans, boxes and photos as they are read",
    "geometry": "Meshes",
    "freespace": "What a scan cannot see",
    "simulation": "geraf2 simulate",
    "cli": "Command line",
    "pipeline": "Runs",
    "batch": "geraf2 batch",
    "benchmark": "geraf2 benchmark",
    "importers": "geraf2 import",
    "inspection": "geraf2 inspect",
    "photos": "geraf2 los",
    "planning": "geraf2 plan",
    "viewing": "geraf2 view",
    "calibration": "Calibration",
}
PROGRAMS = ("geraf2", "pip", "rosbags-convert")
"""Programs whose call is a hint."""


@dataclass(frozen=True)
class Message:
    """One call in the code that says something to a user."""

    module: str
    kind: str
    """"error", "warning"."""
    text: str
    expected: str = ""
    hint: str = ""


def words(node: ast.expr | None) -> str:
    """Text of an expression; what is only known when it runs is an ellipsis."""
    if node is None or (isinstance(node, ast.Constant) and node.value is None):
        return ""
    if isinstance(node, ast.Constant):
        return str(node.value)
    if isinstance(node, ast.JoinedStr):
        return "".join(words(part) for part in node.values)
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
        return words(node.left) + words(node.right)
    if isinstance(node, ast.IfExp):
        return words(node.body) if words(node.body) != "…" else words(node.orelse)
    return "…"


def _texts(scope: ast.AST) -> dict[str, ast.expr]:
    """Names that hold the text of a message: `msg = f"..."`; once, or the text is not known."""
    found: dict[str, ast.expr] = {}
    for node in ast.walk(scope):
        if (
            isinstance(node, ast.Assign)
            and isinstance(node.targets[0], ast.Name)
            and isinstance(node.value, ast.Constant | ast.JoinedStr | ast.BinOp)
        ):
            name = node.targets[0].id
            found[name] = ast.Constant("…") if name in found else node.value
    return found


def _messages(tree: ast.Module, module: str) -> Iterator[Message]:
    blocks = [tree, *(node for node in tree.body if isinstance(node, ast.ClassDef))]
    for scope in (n for block in blocks for n in block.body if isinstance(n, ast.FunctionDef)):
        texts = _texts(scope)

        def said(node: ast.expr | None, texts: dict[str, ast.expr] = texts) -> str:
            return words(texts.get(node.id, node) if isinstance(node, ast.Name) else node)

        for node in ast.walk(scope):
            if not isinstance(node, ast.Call):
                continue
            called = getattr(node.func, "attr", getattr(node.func, "id", ""))
            keys = {key.arg: key.value for key in node.keywords}
            if called == "UserError":
                what = node.args[0] if node.args else keys.get("what")
                expected, hint = said(keys.get("expected")), said(keys.get("hint"))
                yield Message(module, "error", said(what), expected, hint)
            elif node.args and (
                called in ("warning", "warn") or (called == "error" and "checks" in module)
            ):
                kind = "error" if called == "error" else "warning"
                action = said(node.args[1]) if len(node.args) > 1 else ""
                yield Message(module, kind, said(node.args[0]), hint=action)


@cache
def collect() -> list[Message]:
    """All messages, each once, in the order of the files."""
    found: dict[Message, None] = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        module = ".".join(path.relative_to(PACKAGE).with_suffix("").parts)
        text = path.read_text(encoding="utf-8")
        if "UserError(" in text or "warn" in text:
            found |= dict.fromkeys(_messages(ast.parse(text), module))
    letters = re.compile(r"[A-Za-z]{3}")
    return [message for message in found if letters.search(message.text)]


def findings() -> list[Message]:
    """Messages about data, rather than refusals of input."""
    return [m for m in collect() if m.kind == "warning" or "checks" in m.module]


def escape(text: str) -> str:
    """Text of the code in a page of Markdown."""
    return " ".join(text.split()).replace("|", r"\|").replace("<", r"\<").replace("*", r"\*")


def _advice(message: Message) -> str:
    """Say in whole sentences what was expected and what to do; empty where the code does not."""
    said = []
    if message.expected:
        known = message.expected != "…"
        said.append(f"geraf2 expects {message.expected}." if known else "The line says what fits.")
    if message.hint:
        hint = "the line says what to do" if message.hint == "…" else message.hint
        is_command = hint.split()[0] in PROGRAMS
        end = "" if hint.endswith("?") else "."
        said.append(f"Run {hint}." if is_command else f"{hint[:1].upper()}{hint[1:]}{end}")
    return " ".join(said)


def errors_page() -> str:
    """Errors by area: message, what was expected, what to do."""
    areas: dict[str, dict[str, str]] = defaultdict(dict)
    for message in collect():
        if message.kind != "error" or "checks" in message.module:
            continue
        first = message.module.removeprefix("apps.").split(".")[0]
        advice = escape(_advice(message))
        entry = escape(message.text) + (f"\n: {advice}" if advice else "")
        areas[AREAS.get(first, "Everything else")].setdefault(message.text, entry)
    parts = [
        "# Every error",
        "Collected from the code. An ellipsis stands for what is known when it happens: a name, a "
        "value, a file. Each ends with exit code 2 and leaves what existed as it was. Below a "
        "message is what geraf2 expects and what to do. A message without such a line says by "
        "itself what is wrong with the thing that it names.",
    ]
    for area in [*dict.fromkeys(AREAS.values()), "Everything else"]:
        if entries := sorted(areas[area].values()):
            parts += [f"## {area}", *entries]
    return "\n\n".join(parts) + "\n"


def causes(docs: Path) -> list[dict[str, str]]:
    """Causes written by hand, each for the messages that hold its words."""
    return tomllib.loads((docs / CAUSES).read_text(encoding="utf-8"))["cause"]


def unexplained(docs: Path) -> list[str]:
    """Warnings that have no cause yet."""
    known = causes(docs)
    said = [message.text for message in findings()]
    return [text for text in said if not any(entry["says"] in text for entry in known)]


def warnings_page(docs: Path) -> str:
    """Page of the messages about data, each with its cause and what to do, if the line has none."""
    known = causes(docs)
    parts = [
        "# Every warning",
        "Collected from the code. An ellipsis stands for what is known when it happens: a name, a "
        "value, a file. Below each message are its cause and what to do.",
    ]
    for message in findings():
        match = next((entry for entry in known if entry["says"] in message.text), {})
        parts.append(
            f"{escape(message.text)}\n: {match.get('cause', '')} "
            f"{match.get('do', '') or escape(_advice(message))}".strip()
        )
    return "\n\n".join(parts) + "\n"
