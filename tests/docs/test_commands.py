"""Commands and Python of tutorials and how-tos: each runs as the page prints it, in its order.

Only what is slow is made smaller: a simulation gives the small capture of the examples in the box
of its spec, reconstructions, trainings and pictures are coarse, and a batch has one worker, which
is a thread. The demo and the recording of the tutorials are made once.
"""

import doctest
import json
import re
import runpy
import shlex
import shutil
import sys
import tomllib
from collections.abc import Iterator
from contextlib import redirect_stdout
from dataclasses import replace
from functools import cache
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

import geraf2
from geraf2 import examples, load_capture, save_capture
from geraf2 import simulate as simulate_whole
from geraf2.apps.inspection import expected_echoes, measured_windows
from geraf2.apps.live import session
from geraf2.apps.photos import los
from geraf2.apps.photos.config import GridStage, PhotoConfig
from geraf2.apps.planning import scan_time
from geraf2.cli.main import main
from geraf2.pipeline.commands import simulate
from geraf2.report import overview
from geraf2.surfaces import FitConfig
from helpers.drawing import not_drawn  # noqa: F401 - a fixture of the tests here
from helpers.inspected import few_starts
from helpers.one_process import in_one_process  # noqa: F401 - as above
from helpers.ros_bag import scan_path, write_bag

LEFT_OUT = {
    "view": "serves until it is stopped: tests/apps/viewing",
    "--resume": "continues a long training: tests/cli/test_paper_preset.py",
    "s3://": "needs a store: tests/apps/batch/test_object_store.py",
    "tcp://HOST": "needs a scheduler: tests/apps/batch/test_deployment.py",
    "bench/python/": "measures for minutes: tests/test_bench_scripts.py",
}
"""How words of commands begin that are not run."""
COARSE = ["--preset", "fast", "--fit.spacing-m", "0.008"]
SMALLER = {
    "reconstruct": [*COARSE, "--no-report"],
    "batch": [*COARSE, "--workers", "1"],
    "belt": ["--workers", "1"],
    "evaluate": ["--n-samples", "1000"],
    "live": ["--no-report"],
    "bench/photos/carton_photos.py": [
        *("--photos", "12"),
        *("--size-px", "96", "72"),
        *("--focal-length-px", "96"),
    ],
}
"""Arguments that are added to commands and scripts."""
STEP = re.compile(
    r"^```(?P<kind>\w+)\n(?P<fenced>.*?)^```$|^(?: {4}| {6})(?P<line>\S[^\n]*)$",
    re.MULTILINE | re.DOTALL,
)
N_FRAMES = 3906
"""Of the tutorial's recording."""


def pages(root: Path) -> list[str]:
    """Names of the pages that the lists of tutorials and of how-tos hold."""
    docs, names = root / "docs", list[str]()
    for index in (*docs.glob("tutorials/index.md"), *docs.glob("how-to/index.md")):
        listed = index.read_text(encoding="utf-8").partition("{toctree}")[2]
        found = re.findall(r"^[\w./-]+$", listed, re.MULTILINE)
        paths = ((index.parent / name).resolve() for name in found)
        names += [path.relative_to(docs).as_posix() for path in paths]
    return names


ROOT = Path(__file__).parents[2]


@cache
def small(walls):
    """Small capture in these walls, and its truth."""
    return simulate_whole(replace(examples.small_scene(), walls=walls), seed=0)


def made_small(spec, **_):
    return simulate_whole(spec, seed=0) if spec.belt else small(spec.walls)


@pytest.fixture
def quick(monkeypatch):
    fast = geraf2.FastPreset(fit=FitConfig(spacing_m=0.01))
    grids = PhotoConfig(stages=(GridStage(n_longest=24, n_steps=20),), rays_per_step=256)
    monkeypatch.setattr(simulate, "simulate", made_small)
    monkeypatch.setattr(scan_time, "_SPACINGS_M", (0.004,))  # of 1 to 8 mm
    monkeypatch.setattr(scan_time, "_RAISED_DEG", (40.0,))  # of 30 to 50 degrees
    monkeypatch.setattr(measured_windows, "_PARTS", 1)  # of a plane, along each side
    monkeypatch.setattr(expected_echoes, "_PIECE_M", 0.004)
    monkeypatch.setattr(overview, "_N_VOXELS", 12)
    monkeypatch.setattr(session, "preset_type", lambda _: lambda: fast)
    monkeypatch.setattr(los, "photo_config", lambda preset, seed: grids)
    with few_starts():
        yield


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Folder with the demo and the recording of the tutorials."""
    folder = tmp_path_factory.mktemp("made")
    script("examples/ti_recording.py", str(folder / "ti"))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(simulate, "simulate", made_small)
        spec, scene = ROOT / "python/geraf2/simulation/demo.toml", str(folder / "demo" / "scene")
        assert main(["simulate", str(spec), scene, "--quiet"]) == 0
        coarse = [*SMALLER["reconstruct"], "--quiet"]
        assert main(["reconstruct", scene, str(folder / "demo" / "run"), *coarse]) == 0
    return folder


def script(*words: str) -> None:
    """Run a script of the repository; tests/test_examples.py has processes of their own."""
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(StringIO()):
        patch.setattr(sys, "argv", list(words))
        runpy.run_path(str(ROOT / words[0]), run_name="__main__")


def files_of(page: str, start: int) -> str | None:
    """Name of the file that a fence is to be saved as, from the text before it."""
    named = re.findall(r"`(\w+\.(?:toml|csv))`", page[max(0, start - 600) : start])
    return named[-1] if named else None


def commands(line: str) -> Iterator[list[str]]:
    """Words of each command of a line, without what the shell does with their output."""
    for part in line.removeprefix("nohup ").split(" && "):
        words = shlex.split(part, comments=True)
        stops = [n for n, word in enumerate(words) if word in {"|", ">", "&"}]
        yield words[: min(stops, default=len(words))]


def run(words: list[str], made: Path, exit_code: int) -> None:
    """Run one command of a page."""
    if any(word.startswith(tuple(LEFT_OUT)) for word in words):
        return
    smaller = SMALLER.get(words[1], [])
    if words[:2] in (["make", "demo"], ["geraf2", "demo"]):
        default = "out/demo" if words[0] == "make" else "geraf2-demo"
        shutil.copytree(made / "demo", words[2] if len(words) > 2 else default)
    elif words[0] == "cp":
        shutil.copyfile(ROOT / words[1], words[2])
    elif words[:2] == ["python", "examples/ti_recording.py"]:
        shutil.copytree(made / "ti", words[2])
    elif words[:2] == ["python", "examples/play_scan.py"]:
        script(*words[1:-1], "0.01")
    elif words[0] == "python":
        script(*words[1:], *smaller)
    elif words[0] == "geraf2":
        if words[1] == "import" and Path("scene").exists():  # made by another line of the page
            words = ["imported" if word == "scene" else word for word in words]
            shutil.rmtree("imported", ignore_errors=True)
        chosen = words[1] == "reconstruct" and {"--preset", "--config"} & set(words)
        assert main([*words[1:], *([] if chosen else smaller)]) == exit_code, " ".join(words)


def recordings() -> None:
    """Write the recording of the tutorial as other files, whose clock is that of the page."""
    frames = np.fromfile("adc_data.bin", "<i2").reshape(N_FRAMES, -1)
    path = scan_path()
    times = np.linspace(0.25, path[0][-1] - 0.25, N_FRAMES)
    kinds = {"adc": "std_msgs/msg/Int16MultiArray", "poses": "pose"}
    bag = write_bag(Path("bag"), path, (times, frames), **kinds)
    shutil.copyfile(next(bag.glob("*.mcap")), "scan.mcap")
    times = 1.7e9 + 3e-3 * np.arange(N_FRAMES)
    row, column = np.divmod(np.arange(N_FRAMES), 63)
    column = np.where(row % 2, 62 - column, column)  # there and back
    rows = np.stack([times, 0 * times, 0.002 * column, 0.001 * row], axis=1)
    np.savetxt("log.csv", rows, "%.6f", ",", header="time_s,x_m,y_m,z_m", comments="")
    poses = examples.small_capture()[0].poses
    names = ("signal", "tx_positions", "rx_positions", "axes")
    savemat("scan.mat", {name: np.stack([getattr(p, name) for p in poses]) for name in names})


def prepare(name: str, made: Path) -> dict[str, object]:
    """Make what a page says that the reader has: files, and names of Python."""
    if name == "how-to/calibrate":
        shutil.copytree(made / "demo", "out/demo")
    if name == "how-to/live":  # each plane takes a second
        whole = load_capture(made / "demo" / "scene")
        save_capture(replace(whole, poses=whole.poses[::3]), "out/demo/scene")
    if name == "inspection":
        shutil.copytree(made / "demo", "geraf2-demo")
    if name == "batch":
        shutil.copytree(made / "demo" / "scene", "scans/a")
    if name == "bring-your-own-scan":
        shutil.copytree(made / "ti", ".", dirs_exist_ok=True)
        Path("radar.toml").unlink()  # the page has its own
        recordings()
    if name in {"how-to/recipes", "how-to/verdict"}:
        save_capture(examples.small_capture()[0], "scene")
    if name != "how-to/recipes":
        return {}
    assert main(["reconstruct", "scene", "out", *SMALLER["reconstruct"]]) == 0
    raw = (ROOT / "docs" / "tutorials" / "raw-files.md").read_text(encoding="utf-8")
    written: dict[str, object] = {}
    for step in STEP.finditer(raw.partition("## Import it")[0]):
        run_code(step["fenced"], written)
    capture = examples.small_capture()[0]
    pose = capture.poses[0]
    return {
        "signal": pose.signal,
        "tx": pose.tx_positions,
        "rx": pose.rx_positions,
        "points": np.zeros((1, 3)),
        "waveform": capture.waveform,
    }


def run_code(code: str, names: dict[str, object]) -> None:
    """Execute Python of a page; where it has prompts, it prints what the page states."""
    if ">>> " not in code:
        exec(code, names)
        return
    test = doctest.DocTestParser().get_doctest(code, names, "page", None, 0)
    stated: list[str] = []
    # The page's names last from fence to fence.
    test.globs = names
    results = doctest.DocTestRunner(verbose=False).run(test, out=stated.append, clear_globs=False)
    assert results.failed == 0, "".join(stated)


@pytest.mark.slow
@pytest.mark.usefixtures("quick", "in_one_process")
@pytest.mark.parametrize("name", pages(ROOT))
def test_a_page_runs_as_printed(name, made, project_root, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    page = (project_root / "docs" / f"{name}.md").read_text(encoding="utf-8")
    names = prepare(name, made)
    for step in STEP.finditer(page):
        line, kind = step["line"], step["kind"]
        if kind == "python":
            run_code(step["fenced"], names)
        elif kind in {"toml", "text"} and (file := files_of(page, step.start())):
            if Path(file).exists():  # an example wrote it before the page shows it
                assert tomllib.loads(Path(file).read_text()) == tomllib.loads(step["fenced"])
            Path(file).write_text(step["fenced"])
        elif line and re.match(r"(geraf2|make demo|python|cp|nohup) ", line + " "):
            after = page[step.end() :].lstrip("\n").partition("\n\n")[0]
            for words in commands(line):
                if words[0] == "cd":
                    monkeypatch.chdir(words[1])
                    continue
                run(words, made, 3 if "result   fail" in after else 0)
    if name == "tutorials/ti-board":
        scores = json.loads(Path("out", "metrics.json").read_text())["scores"]
        assert next(s["f1"] for s in scores if s["threshold_m"] == 0.005) > 0.8
