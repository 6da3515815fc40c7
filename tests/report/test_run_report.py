import json
import re
import shutil

import numpy as np
import pytest
from PIL import Image

from geraf2.errors import UserError
from geraf2.evaluation import evaluate_mesh, write_metrics
from geraf2.fields import SdfGrid
from geraf2.io.mesh import Evidence, write_mesh
from geraf2.io.run_folder import RunFolder, mesh_digest
from geraf2.pipeline.reconstruction import load_run
from geraf2.report import canvas, read_run, write_report
from geraf2.scene import Grid
from helpers import solids
from helpers.drawing import blank, small_pictures
from helpers.glint_sets import glints_on_sphere
from helpers.run_folders import add_steps, record_run
from helpers.shadows import shadows

PICTURE = re.compile(r"src=\"data:image/(?:png|webp);base64,")


def ball(radius):
    n = 642
    evidence = np.full(n, Evidence.SEEN, dtype=np.uint8)
    return solids.ball(radius, expected_error_m=np.full(n, 5e-4), evidence=evidence)


@pytest.fixture(scope="module")
def truth():
    return ball(0.03)


@pytest.fixture(scope="module")
def built(truth, tmp_path_factory):
    path = tmp_path_factory.mktemp("built") / "run"
    path.mkdir()
    grid = Grid.cube((0, 0, 0), 0.05, 21)
    values = (np.linalg.norm(grid.points(), axis=1) - 0.032).reshape(grid.shape)
    SdfGrid(grid=grid, values=values.astype(np.float32)).save(path / "sdf.npz")
    glints_on_sphere(0.032, 60, poses=np.arange(60) % 6).save(path / "glints.npz")
    mesh = ball(0.032)
    write_mesh(mesh, path / "mesh_content.ply")
    metrics = evaluate_mesh(mesh, truth, n_samples=500)
    extra = {"seconds": {"image": 3.25}, **mesh_digest(path)}
    write_metrics(metrics, path / "metrics.json", extra=extra)
    (path / "config.toml").write_text('note = "a < b & c"\n')
    run = record_run(path, numbers={"glints": {}, "mesh": {}}, warnings=["spacing is <wide>"])
    run.log("all is well", level="info")
    return path


@pytest.fixture
def run(built, tmp_path, monkeypatch):
    """A copy, whose reports have blank pictures."""
    small_pictures(monkeypatch)
    monkeypatch.setattr(canvas.Sheet, "save", blank)
    return shutil.copytree(built, tmp_path / "run")


@pytest.fixture(scope="module")
def reported(built, truth, tmp_path_factory):
    """Folder of the run with a report that holds everything."""
    run = shutil.copytree(built, tmp_path_factory.mktemp("reported") / "A <ball> & its shell")
    volume = np.random.default_rng(0).random((5, 5, 5))
    with pytest.MonkeyPatch.context() as patch:
        small_pictures(patch)
        report = write_report(
            run,
            truth=truth,
            heatmap=(volume, Grid.cube((0, 0, 0), 0.05, 5)),
            provenance={"importer": "geraf-sens"},
        )
    assert report == run / "report.html"
    return run


def outline_of_a_ball():
    cells = 0.002 * np.arange(-20, 21)
    r = np.hypot(*np.meshgrid(cells, cells, indexing="ij"))
    return shadows([r > 0.031], [1])


def test_shadows_are_those_of_this_run(run):
    outline_of_a_ball().save(run / "silhouettes.npz")
    text = write_report(run).read_text()
    assert "Shadows" not in text  # files of an earlier run with another preset
    add_steps(RunFolder.read(run), {"outlines": {}})
    text = write_report(run).read_text()
    assert '<section id="shadows"' in text
    assert (run / "figures" / "shadows.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"


def test_report_holds_pictures_metrics_definitions_and_configuration(reported):
    text = (reported / "report.html").read_text()
    assert text.count("<figure") == 5
    assert len(PICTURE.findall(text)) > 10  # in panels
    for name in ("mesh", "errors", "slices", "glints", "projections"):
        assert (reported / "figures" / f"{name}.png").stat().st_size > 1000
    metrics = json.loads((reported / "metrics.json").read_text())
    assert f"{metrics['scores'][1]['f1']:.4f}" in text
    assert f"{metrics['chamfer_1e3_m2']:.4f}" in text
    assert "seconds.image</td><td>3.25" in text
    assert "geraf-sens" in text
    assert "all is well" not in text
    assert "<td>glints</td><td>1.0</td>" in text


def test_report_is_self_contained_and_escapes_what_it_shows(reported):
    text = (reported / "report.html").read_text()
    title = re.search("<title>What is in the box: (.*)</title>", text)[1]
    assert title.endswith("/A &lt;ball&gt; &amp; its shell")
    assert "a &lt; b &amp; c" in text
    assert "spacing is &lt;wide&gt;" in text
    assert "default-src 'none'" in text
    links = re.findall(r"(?:src|href)=\"([^\"]*)", text)
    assert not [link for link in links if re.match(r"(?!data:)[a-z]+:|//", link)]
    assert "mesh_content.ply" in links
    assert "://" not in text
    assert "eval(" not in text


def test_an_empty_folder_gives_a_report_without_content(tmp_path):
    record_run(tmp_path, numbers={})
    text = write_report(tmp_path).read_text()
    assert "Nothing has been reconstructed" in text
    assert "<img" not in text


def test_a_report_without_truth_has_no_error_pictures(run):
    (run / "metrics.json").unlink()
    text = write_report(run).read_text()
    assert text.count("<figure") == 3
    assert "Against the truth" not in text
    assert "an echo came from there" in text


def test_scores_of_another_mesh_are_not_shown(reported, tmp_path, monkeypatch):
    small_pictures(monkeypatch)
    monkeypatch.setattr(canvas.Sheet, "save", blank)
    run = shutil.copytree(reported, tmp_path / "run")
    metrics = json.loads((run / "metrics.json").read_text())
    (run / "metrics.json").write_text(json.dumps(metrics | {"mesh_digest": 32 * "0"}))
    text = write_report(run).read_text()
    assert "Against the truth" not in text
    assert "F1 5 mm" not in text
    assert "beside the truth" not in text
    assert not (run / "figures" / "errors.png").exists()


def test_broken_artefacts_are_user_errors(run, tmp_path):
    with pytest.raises(UserError, match="is no run folder"):
        read_run(tmp_path / "nowhere")
    for text, message in (
        ("{", r"metrics\.json: cannot read the metrics"),
        ("[1]", "is no JSON object, got list; remove the file"),
    ):
        (run / "metrics.json").write_text(text)
        with pytest.raises(UserError, match=message):
            write_report(run)
    assert not (run / "report.html").exists()


def test_rendered_heat_maps_of_this_mesh_are_shown(run):
    views = run / "views"
    views.mkdir()
    Image.new("RGB", (8, 8)).save(views / "angle_060.0_measured.png")
    Image.new("RGB", (8, 8)).save(views / "angle_060.0_rendered.png")

    def text_with(**more):
        record = {"psnr_db": {"60": 33.25}, "mean_psnr_db": 33.25, **mesh_digest(run), **more}
        (views / "psnr.json").write_text(json.dumps(record))
        return write_report(run).read_text()

    text = text_with()
    assert "33.2" in text
    assert "Heat map of the plane at 60 degrees, rendered." in text
    assert 'id="rendered"' not in text_with(mesh_digest=32 * "0")


def test_a_result_shows_itself_in_a_browser(run, monkeypatch):
    opened = []
    monkeypatch.setattr("webbrowser.open", opened.append)
    page = load_run(run).show()
    assert opened == [page.as_uri()]
    assert 'class="viewer"' in page.read_text()
    (run / "mesh_content.ply").unlink()
    assert load_run(run)._repr_html_().startswith("<pre>")
    with pytest.raises(UserError, match="no surface to show"):
        load_run(run).show()
    with pytest.raises(UserError, match=r"has no mesh_content\.ply"):
        _ = load_run(run).content
