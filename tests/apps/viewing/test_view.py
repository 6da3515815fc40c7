"""`geraf2 view`: what is read, what a client of the server is sent, and what it may change."""

import base64
import json
import shutil
import signal
import socket
import subprocess
import sys
import urllib.error
import urllib.request

import numpy as np
import pytest

import geraf2
from geraf2.apps.viewing.server import LiveView, is_same_origin, require_free, scene_of
from geraf2.cli.main import main
from geraf2.errors import UserError
from geraf2.evaluation import evaluate_mesh, write_metrics
from geraf2.fields import SdfGrid
from geraf2.io.atomic import write_npz_atomic
from geraf2.io.mesh import write_mesh
from geraf2.io.run_folder import mesh_digest
from geraf2.io.verdict import Trust
from geraf2.scene import Grid, LosPrior
from helpers import solids
from helpers.browsing import PHONE, SCREENS, require_readable, serious_findings
from helpers.glint_sets import glints_on_sphere
from helpers.ports import free_port
from helpers.run_folders import judge, record_run

RADIUS_M = 0.03
GRID = Grid(origin_m=(-0.05, -0.05, -0.05), spacing_m=0.005, shape=(21, 21, 21))


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A sphere in a box with all that a run may hold."""
    out = tmp_path_factory.mktemp("view") / "ball"
    out.mkdir()
    (out / "figures").mkdir()
    ball = solids.ball(RADIUS_M, 2)
    write_mesh(ball, out / "mesh_content.ply")
    write_mesh(LosPrior.from_box((0.12, 0.12, 0.12)).mesh, out / "mesh_box.ply")
    glints_on_sphere(RADIUS_M, 30, poses=np.arange(30) % 2).save(out / "glints.npz")
    distance = np.linalg.norm(GRID.points(), axis=1).reshape(GRID.shape) - RADIUS_M
    SdfGrid(grid=GRID, values=distance.astype(np.float32)).save(out / "sdf.npz")
    spacing = {"origin_m": np.array(GRID.origin_m), "spacing_m": np.array(GRID.spacing_m)}
    write_npz_atomic(out / "image.npz", {"volume": np.exp(-30 * np.abs(distance)), **spacing})
    side = [[0.4, y, z] for y, z in ((-0.1, -0.1), (0.1, -0.1), (0.1, 0.1), (-0.1, 0.1))]
    (out / "planes.json").write_text(json.dumps({"corners_m": [side, side]}))
    truth = {"vertices": ball.vertices, "faces": ball.faces, "distances_m": np.zeros(162)}
    write_npz_atomic(out / "figures" / "truth.npz", truth)
    scores = evaluate_mesh(ball, ball, n_samples=200, num_threads=1)
    write_metrics(scores, out / "metrics.json", extra=mesh_digest(out))
    record_run(out, "ball")
    return out


@pytest.fixture(scope="module")
def small_capture_folder(tmp_path_factory):
    capture, _ = geraf2.examples.small_capture()
    folder = tmp_path_factory.mktemp("scene") / "small"
    geraf2.save_capture(capture, folder)
    return folder


def test_antennas_of_a_scene_are_where_they_stand(small_capture_folder):
    capture, _ = geraf2.examples.small_capture()
    scene = scene_of(small_capture_folder)
    assert [mesh["label"] for mesh in scene["meshes"]] == ["content", "antennas", "box"]
    assert scene["name"] == "small"
    assert len(scene["planes"]["corners"]) == len(capture.poses)
    stored = scene["meshes"][1]["positions"]
    whole = np.frombuffer(base64.b64decode(stored["values"]["data"]), dtype="<u2").reshape(-1, 3)
    points = np.array(stored["low"]) + np.array(stored["step"]) * whole
    antennas = 1e3 * np.concatenate([pose.phase_centers for pose in capture.poses])
    found = points.reshape(-1, 3, 3).mean(axis=1)
    distance = np.linalg.norm(found[:, None] - antennas[None], axis=2).min(axis=1)
    assert distance.max() < 0.05
    assert len(found) > 0.5 * len(antennas)


def test_a_port_in_use_is_one_line(run, capsys):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(UserError, match=rf"port {port} cannot be used.*port {port + 1}"):
            require_free("127.0.0.1", port)
        assert main(["view", str(run), "--port", str(port)]) == 2
        assert "cannot be used" in capsys.readouterr().err


@pytest.fixture
def view(run):
    made = LiveView([run, run], port=free_port())
    yield made
    made.stop()


def test_the_page_is_read_anew_at_each_visit(view, run):
    with urllib.request.urlopen(view.url, timeout=20) as page:
        assert page.headers["Cache-Control"] == "no-store"
        assert page.read().count(b'"geraf2-view"') == 2
    record = (run / "run.json").read_bytes()
    (run / "run.json").write_text("{")
    try:
        with pytest.raises(urllib.error.HTTPError, match="503"):
            urllib.request.urlopen(view.url, timeout=20)
    finally:
        (run / "run.json").write_bytes(record)
    with pytest.raises(urllib.error.HTTPError, match="404"):
        urllib.request.urlopen(f"{view.url}/elsewhere", timeout=20)
    assert view.ssh_line.startswith(f"ssh -N -L {view.port}:localhost:{view.port} ")


@pytest.mark.browser
@pytest.mark.parametrize(("size", "dark"), SCREENS)
def test_two_runs_have_linked_cameras_scales_and_slices(open_page, view, axe, size, dark):
    page = open_page(view.url, size, dark)
    first, second = page.locator(".viewer.works").all()
    require_readable(page, size)
    assert serious_findings(page, axe) == []
    assert page.trouble == []
    if size == PHONE:
        return
    cameras = "[...document.querySelectorAll('.viewer')].map(e => e.viewer.camera.azimuth)"
    first.locator('[data-view="+y"]').click()
    assert page.evaluate(cameras) == pytest.approx([np.pi / 2] * 2)
    page.get_by_role("button", name="linked cameras").click()
    second.locator('[data-view="-x"]').click()
    assert page.evaluate(cameras) == pytest.approx([np.pi / 2, np.pi])
    second.get_by_label("slice", exact=True).select_option("signed distance, across z")
    second.get_by_label("position of the slice").fill("1000")
    assert second.locator(".slice output").inner_text() == "50.0 mm"
    assert "signed distance [mm]" in second.locator(".legend").inner_text()
    names = second.get_by_label("plane", exact=True).locator("option").all_inner_texts()
    assert names == ["show one plane", "plane 1: at 0°, 0° up", "plane 2: at 0°, 0° up"]
    second.get_by_label("Colour").select_option(label="distance to the truth")
    assert "distance to the truth [mm]" in second.locator(".legend").inner_text()
    assert page.trouble == []


def test_pages_of_other_sites_are_refused(view):
    own = urllib.request.Request(view.url, headers={"Origin": view.url})
    with urllib.request.urlopen(own) as page:
        assert page.status == 200
    other = urllib.request.Request(view.url, headers={"Origin": "http://elsewhere.example"})
    with pytest.raises(urllib.error.HTTPError, match="403"):
        urllib.request.urlopen(other)


@pytest.mark.parametrize(
    ("asked", "origin", "host", "same"),
    [
        ("localhost:8080", None, "127.0.0.1", True),
        ("localhost:8080", "http://localhost:8080", "127.0.0.1", True),
        ("localhost:9000", "http://localhost:9000", "127.0.0.1", True),  # forwarded by SSH
        ("localhost:8080", "http://localhost:3000", "127.0.0.1", False),
        ("localhost:8080", "null", "127.0.0.1", False),
        ("elsewhere.example", "http://elsewhere.example", "127.0.0.1", False),  # of this address
        ("elsewhere.example", None, "127.0.0.1", False),
        ("lab:8080", "http://lab:8080", "0.0.0.0", True),
        ("lab:8080", "http://elsewhere.example", "0.0.0.0", False),
    ],
)
def test_only_a_page_of_the_server_itself_may_ask(asked, origin, host, same):
    headers = {"Host": asked} | ({"Origin": origin} if origin else {})
    assert is_same_origin(headers, host) == same


def test_ctrl_c_is_the_normal_end_of_view(small_capture_folder):
    words = ["view", str(small_capture_folder), "--port", str(free_port())]
    start = "import signal\nsignal.signal(signal.SIGINT, signal.SIG_DFL)\n"
    start += f"import sys\nsys.argv = {['geraf2', *words]}\nfrom geraf2.cli import main\nmain.run()"
    with subprocess.Popen(
        [sys.executable, "-u", "-c", start],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        assert any("Ctrl-C ends it" in line for line in process.stdout)
        process.send_signal(signal.SIGINT)
        error = process.communicate(timeout=60)[1]
    assert (process.returncode, error) == (0, "")


@pytest.mark.browser
def test_an_open_page_follows_the_files_and_keeps_what_was_chosen(open_page, run, tmp_path):
    out = tmp_path / "out"
    view = LiveView([out], port=free_port(), waits=True)
    try:
        with pytest.raises(urllib.error.HTTPError) as early:
            urllib.request.urlopen(view.url, timeout=20)
        assert (early.value.code, early.value.headers["Refresh"]) == (503, "1")
        shutil.copytree(run, out)
        page = open_page(view.url)
        page.locator('[data-view="+y"]').click()
        page.get_by_label("Colour").select_option(label="one colour")
        page.get_by_label("glints", exact=True).check()
        assert page.locator(".verdict").count() == 0
        judge(out, Trust.NOT_TO_BE_TRUSTED)
        write_mesh(solids.ball(2 * RADIUS_M, 2), out / "mesh_content.ply")
        for _ in range(80):  # its policy lets no script wait in the page
            page.wait_for_timeout(250)
            state = page.evaluate(
                "(v => [v.camera.azimuth, v.scene.glints.visible, v.attribute, v.inner.high[0]])"
                "(document.querySelector('.viewer').viewer)"
            )
            if state[3] > 55:
                break
        assert state == [pytest.approx(np.pi / 2), True, None, pytest.approx(60, abs=0.5)]
        assert (
            page.get_by_label("Colour").evaluate("e => e.selectedOptions[0].text") == "one colour"
        )
        assert page.get_by_text("Not to be trusted").is_visible()
        assert page.trouble == []
    finally:
        view.stop()
