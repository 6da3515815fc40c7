"""Pages of the documentation: what they refer to is there, messages of the code are explained."""

import importlib
import pkgutil
import re
import sys

import numpy as np
import pytest

from geraf2.io.regular import BINARY_BYTES, RECORD_BYTES, TEXT_BYTES


@pytest.fixture
def site(project_root, monkeypatch):
    """Import a module of the site's own code."""
    monkeypatch.syspath_prepend(project_root / "docs" / "_ext")
    yield importlib.import_module
    for name in ("messages", "docstrings", "flowchart", "formulas"):
        sys.modules.pop(name, None)


def test_every_warning_has_a_cause_and_a_remedy(site, project_root):
    messages = site("messages")
    assert messages.findings()
    assert messages.unexplained(project_root / "docs") == []


def test_each_input_of_the_audit_has_tests_and_the_limits_of_the_code(project_root):
    table = [
        line for line in (project_root / "SECURITY.md").read_text().splitlines() if "|" in line
    ]
    rows = [line.strip("|").split("|") for line in table[2:]]
    assert len(rows) > 10
    for name, limits, tests in rows:
        paths = re.findall(r"`([^`]+)`", tests)
        assert paths, name
        for path in paths:
            folder, braces, rest = path.partition("{")
            for one in rest.partition("}")[0].split(",") if braces else [""]:
                file = f"{folder}{one}{rest.partition('}')[2]}"
                assert (project_root / "tests" / file).is_file(), file
        stated = set(re.findall(r"(\d+) (MiB|GiB)", limits))
        assert stated <= {("64", "MiB"), ("512", "MiB"), ("4", "GiB")}, name
    assert (RECORD_BYTES, TEXT_BYTES, BINARY_BYTES) == (64 * 2**20, 512 * 2**20, 4 * 2**30)


def test_errors_are_collected_with_what_to_do(site):
    messages = site("messages")
    stated = {message.text: message for message in messages.collect()}
    lost = stated["no such scene"]
    assert lost.module == "io.container"
    assert lost.hint == "make one with 'geraf2 import'"
    assert lost.kind == "error"
    assert "no such scene\n: Make one with 'geraf2 import'.\n" in messages.errors_page()


def _resolves(name: str, module: str) -> bool:
    """Whether a cross-reference of a module's docstring names something that is there."""
    if name.startswith("geraf2."):
        package, _, rest = name.rpartition(".")
        found = importlib.import_module(package)
        inside = getattr(found, "__path__", ())
        return hasattr(found, rest) or rest in {m.name for m in pkgutil.iter_modules(inside)}
    found = importlib.import_module(module)
    first, *rest = name.split(".")
    holders = [found, *(kind for kind in vars(found).values() if isinstance(kind, type))]
    return any(
        hasattr(holder, first) and (not rest or hasattr(getattr(holder, first), rest[0]))
        for holder in holders
    )


def test_what_docstrings_refer_to_is_there(project_root):
    package = project_root / "python"
    broken, n_checked = [], 0
    for path in sorted(package.rglob("*.py")):
        module = ".".join(path.relative_to(package).with_suffix("").parts)
        text = path.read_text(encoding="utf-8")
        for name in re.findall(r":(?:func|class|data|meth|mod):`([^`]+)`", text):
            n_checked += 1
            if not _resolves(name, module.removesuffix(".__init__")):
                broken.append(f"{module}: {name}")
    assert n_checked > 0
    assert broken == []


def test_a_flow_chart_is_drawn_with_all_its_steps(site, project_root):
    pytest.importorskip("docutils", reason="needs the packages of the group docs")
    flowchart = site("flowchart")
    text = (project_root / "docs" / "architecture.md").read_text(encoding="utf-8")
    blocks = re.findall(r"```mermaid\n(.*?)```", text, flags=re.DOTALL)
    charts = [chart for block in blocks for chart in flowchart.parse(block.splitlines()).values()]
    assert charts
    for chart in charts:
        at = flowchart.positions(chart)
        assert len(set(at.values())) == len(chart.texts)  # no box on another
        assert all(at[a][0] < at[b][0] for a, b, dotted in chart.steps if not dotted)
        assert flowchart.svg(chart).count('class="head"') == len(chart.steps) > 0
    with pytest.raises(ValueError, match="no step of a flow chart"):
        flowchart.parse(["a ==> b"])


def test_the_pictures_of_the_physics_show_what_their_text_states(project_root, monkeypatch):
    """Behind the surface by the whole aperture, on it by a sub-aperture; the page has both."""
    monkeypatch.syspath_prepend(project_root / "tools")
    draw = importlib.import_module("draw_physics")
    antennas, points = draw.line(0.25, 0.0035), draw.raster(0.06, 101)
    behind = {
        name: draw.RADIUS - np.linalg.norm(draw.peak_of(weights, antennas, points))
        for name, weights in (
            ("whole", np.ones(len(antennas))),
            ("part", draw.hann(antennas, 0.0, 0.08)),
            ("outer part", draw.hann(antennas, 0.08, 0.08)),
        )
    }
    assert behind["whole"] == pytest.approx(0.010, abs=0.003)  # "10 mm behind the surface"
    assert abs(behind["part"]) < 0.0013  # "on the surface": points lie 1.2 mm apart
    assert abs(behind["outer part"]) < 0.0013


def test_the_example_of_the_first_page_prints_what_it_states(
    project_root, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    text = (project_root / "README.md").read_text(encoding="utf-8")
    code, stated = re.findall(r"^```(?:python|text)\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    exec(compile(code, "README.md", "exec"), {})
    assert capsys.readouterr().out == stated
    assert (tmp_path / "ball.ply").exists()
