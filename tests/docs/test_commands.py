"""Commands of tutorials and how-tos: each runs as the page prints it, in the order of the page.

Only what is slow is made smaller: a simulation gives the small capture of the examples in the box
of its spec, reconstructions and pictures are coarse, a batch has one worker, and the demo is made
once.
"""

import doctest
import json
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest

from geraf2 import examples, save_capture
from geraf2 import simulate as simulate_whole
from geraf2.cli.main import main
from geraf2.pipeline.commands import simulate
from geraf2.report import overview
from helpers.drawing import not_drawn  # noqa: F401 - a fixture of the tests here
from helpers.inspected import few_starts

PAGES = ("tutorials/*", "how-to/*")
ELSEWHERE = {
    "how-to/belt": "tests/apps/belt",
    "how-to/live": "tests/cli/test_live.py",
}
"""Pages whose commands wait for parcels or planes, and where those are tested."""
LEFT_OUT = {
    "view": "serves until it is stopped: tests/apps/viewing",
    "--resume": "continues a long training: tests/cli/test_paper_preset.py",
}
"""Words of commands that are not run."""
COARSE = ["--preset", "fast", "--fit.spacing-m", "0.008", "--fit.distance-rounds", "1"]
SMALLER = {"reconstruct": [*COARSE, "--no-report"], "batch": [*COARSE, "--workers", "1"]}
"""Flags that are added to commands."""
STEP = re.compile(
    r"^```(?P<kind>\w+)\n(?P<fenced>.*?)^```$|^(?: {4}| {6})(?P<line>\S[^\n]*)$",
    re.MULTILINE | re.DOTALL,
)


def pages(root: Path) -> list[str]:
    docs = root / "docs"
    found = (path for pattern in PAGES for path in sorted(docs.glob(f"{pattern}.md")))
    names = (path.relative_to(docs).with_suffix("").as_posix() for path in found)
    return [name for name in names if name not in ELSEWHERE and not name.endswith("/index")]


ROOT = Path(__file__).parents[2]


@cache
def small(walls):
    """Small capture in these walls, and its truth."""
    return simulate_whole(replace(examples.small_scene(), walls=walls), seed=0)


@pytest.fixture
def quick(monkeypatch):
    monkeypatch.setattr(simulate, "simulate", lambda spec, **_: small(spec.walls))
    monkeypatch.setattr(overview, "_N_VOXELS", 12)
    with few_starts():
        yield


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    folder = tmp_path_factory.mktemp("demo") / "demo"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(simulate, "simulate", lambda spec, **_: small(spec.walls))
        spec, scene = ROOT / "python/geraf2/simulation/demo.toml", str(folder / "scene")
        assert main(["simulate", str(spec), scene, "--quiet"]) == 0
        coarse = [*SMALLER["reconstruct"], "--quiet"]
        assert main(["reconstruct", scene, str(folder / "run"), *coarse]) == 0
    return folder


def files_of(page: str, start: int) -> str | None:
    """Name of the file that a fence is to be saved as, from the text before it."""
    named = re.findall(r"`(\w+\.(?:toml|csv))`", page[max(0, start - 300) : start])
    return named[-1] if named else None


def commands(line: str) -> Iterator[list[str]]:
    """Words of each command of a line, without what the shell does with their output."""
    for part in line.split(" && "):
        words = shlex.split(part, comments=True)
        stops = [n for n, word in enumerate(words) if word in {"|", ">", "&"}]
        yield words[: min(stops, default=len(words))]


def run(words: list[str], demo: Path, exit_code: int) -> None:
    """Run one command of a page."""
    if words[:2] in (["make", "demo"], ["geraf2", "demo"]):
        default = "out/demo" if words[0] == "make" else "geraf2-demo"
        shutil.copytree(demo, words[2] if len(words) > 2 else default)
    elif words[0] == "cp":
        shutil.copyfile(ROOT / words[1], words[2])
    elif words[0] == "python":
        script = [sys.executable, str(ROOT / words[1]), *words[2:]]
        subprocess.run(script, check=True, timeout=300, stdout=subprocess.DEVNULL)
    elif words[0] == "geraf2" and not set(words) & set(LEFT_OUT):
        if words[1] == "import" and Path("scene").exists():  # another recipe's
            words = ["imported" if word == "scene" else word for word in words]
        chosen = words[1] == "reconstruct" and {"--preset", "--config"} & set(words)
        smaller = [] if chosen else SMALLER.get(words[1], [])
        assert main([*words[1:], *smaller]) == exit_code, " ".join(words)


def prepare(name: str, demo: Path) -> None:
    """Make what a page says that the reader has."""
    if name == "how-to/calibrate":
        shutil.copytree(demo, "out/demo")
    if name in {"how-to/recipes", "how-to/verdict"}:
        save_capture(examples.small_capture()[0], "scene")
    if name == "how-to/recipes":
        assert main(["reconstruct", "scene", "out", *SMALLER["reconstruct"]]) == 0
        raw = (ROOT / "docs" / "tutorials" / "raw-files.md").read_text(encoding="utf-8")
        run_code(raw.partition("## Import it")[0], {})


def run_code(code: str, names: dict[str, object]) -> None:
    """Execute Python of a page, with prompts or without."""
    found = doctest.DocTestParser().get_examples(re.sub(r"^```.*$", "", code, flags=re.MULTILINE))
    exec("".join(example.source for example in found) if found else code, names)


@pytest.mark.slow
@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize("name", pages(ROOT))
def test_the_commands_of_a_page_run_as_printed(name, demo, project_root, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    page = (project_root / "docs" / f"{name}.md").read_text(encoding="utf-8")
    prepare(name, demo)
    n_run, names = 0, {}
    for step in STEP.finditer(page):
        line, kind = step["line"], step["kind"]
        if kind == "python" and n_run == 0:
            run_code(step["fenced"], names)
        elif kind in {"toml", "text"} and (file := files_of(page, step.start())):
            if Path(file).exists():  # an example wrote it before the page shows it
                assert tomllib.loads(Path(file).read_text()) == tomllib.loads(step["fenced"])
            Path(file).write_text(step["fenced"])
        elif line and re.match(r"(geraf2|make demo|python|cp) ", line + " "):
            after = page[step.end() :].lstrip("\n").partition("\n\n")[0]
            for words in commands(line):
                if words[0] == "cd":
                    monkeypatch.chdir(words[1])
                    continue
                run(words, demo, 3 if "result   fail" in after else 0)
            n_run += 1
    if name == "tutorials/ti-board":
        scores = json.loads(Path("out", "metrics.json").read_text())["scores"]
        assert next(s["f1"] for s in scores if s["threshold_m"] == 0.005) > 0.8
    assert n_run > 0 or "    geraf2 " not in page
