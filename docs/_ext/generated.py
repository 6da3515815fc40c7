"""Pages that are written from the code when the site is built, into docs/generated."""

import contextlib
import io
import re
import shutil
from pathlib import Path
from typing import Any

from messages import errors_page, warnings_page

from geraf2.cli import main as cli
from geraf2.pipeline.presets import PRESETS

# Pages that lie above docs, and what the site calls its copies.
PROJECT = {
    "CHANGELOG": "changelog",
    "CONTRIBUTING": "contributing",
    "SECURITY": "security",
    "bench/README": "bench",
}
ABOVE = re.compile(rf"\]\((?:\.\./)+({'|'.join(PROJECT)})\.md")
BESIDE = re.compile(rf"\]\(({'|'.join(PROJECT)})\.md")
FROM_ROOT = re.compile(r"\]\((?:\.\./)?docs/")
CLI_HEAD = """# {title}

{summary}

```text
{text}
```
"""


def help_of(*arguments: str) -> str:
    """Text that the command line prints for help."""
    said = io.StringIO()
    with contextlib.redirect_stdout(said):
        cli.main(list(arguments))
    return said.getvalue().rstrip()


def command_pages() -> dict[str, str]:
    """Page of each command, and of the constants of each preset, by file name."""
    pages = {
        f"cli/{name}.md": CLI_HEAD.format(
            title=f"geraf2 {name}",
            summary=f"{command.summary[0].upper()}{command.summary[1:]}.",
            text=help_of(name, "--help"),
        )
        for name, command in cli.COMMANDS.items()
    }
    for preset in PRESETS:
        pages[f"cli/preset-{preset}.md"] = CLI_HEAD.format(
            title=f"Constants of the preset {preset}",
            summary="Each is a flag of `geraf2 reconstruct`, and a key of `config.toml`.",
            text=help_of("reconstruct", "--help-preset", preset),
        )
    return pages


def project_pages(root: Path) -> dict[str, str]:
    """Pages about the project that lie above docs; their links lead to the site's own pages."""
    pages = {}
    for name, title in PROJECT.items():
        text = FROM_ROOT.sub("](../../", (root / f"{name}.md").read_text(encoding="utf-8"))
        pages[f"project/{title}.md"] = BESIDE.sub(lambda m: f"]({PROJECT[m[1]]}.md", text)
    return pages


def to_site(app: Any, page: str, text: list[str]) -> None:
    """Let links to pages above docs lead to their copies on the site, and README to its index."""
    del app
    up = "../" * page.count("/")
    text[0] = ABOVE.sub(lambda found: f"]({up}generated/project/{PROJECT[found[1]]}.md", text[0])
    text[0] = text[0].replace(f"]({up}../README.md", f"]({up}index.md")


def more_page(docs: Path) -> str:
    """Page of the pages that no index names yet, so that each can be reached."""
    indexes = "\n".join(path.read_text(encoding="utf-8") for path in docs.glob("*/index.md"))
    named = set(re.findall(r"^\.\./([\w-]+)$", indexes, flags=re.MULTILINE))
    pages = {path.stem for path in docs.glob("*.md")} - {"README", "index"}
    listed = "\n".join(f"../{name}" for name in sorted(pages - named))
    if not listed:
        return "# More pages\n\nNone: the indexes name all.\n"
    return f"# More pages\n\n```{{toctree}}\n:maxdepth: 1\n\n{listed}\n```\n"


def write_pages(folder: Path) -> None:
    """Write every page; one that did not change keeps its time, so that Sphinx reads it once."""
    pages = command_pages() | project_pages(folder.parent.parent)
    pages["more.md"] = more_page(folder.parent)
    pages |= {"errors.md": errors_page(), "warnings.md": warnings_page(folder.parent)}
    for name, text in pages.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")
    for path in {*folder.glob("cli/*.md")} - {folder / name for name in pages}:
        path.unlink()


def write(app: Any) -> None:
    """Write the pages before Sphinx looks for them."""
    folder = Path(app.srcdir) / "generated"
    write_pages(folder)
    if app.config.autosummary_generate:  # names that are no more leave no page behind
        shutil.rmtree(folder / "api", ignore_errors=True)


def setup(app: Any) -> dict[str, bool]:
    """Run before the pages are read."""
    app.connect("builder-inited", write, priority=100)
    app.connect("source-read", to_site)
    return {"parallel_read_safe": True}
