"""`geraf2 view`: what is read, what a client of the server is sent, and what it may change."""

import json
import socket
import urllib.error
import urllib.request

import numpy as np
import pytest

from geraf2.apps.viewing.layers import Volume, source_of
from geraf2.apps.viewing.server import LiveView, is_same_origin, require_free
from geraf2.cli.main import main
from geraf2.errors import UserError
from geraf2.evaluation import evaluate_mesh, write_metrics
from geraf2.fields import SdfGrid
from geraf2.io.atomic import write_npz_atomic
from geraf2.io.mesh import write_mesh
from geraf2.io.run_folder import RunFolder, mesh_digest
from geraf2.scene import Grid, LosPrior
from helpers import solids
from helpers.glint_sets import glints_on_sphere

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
    folder = RunFolder(out, "digest", "ball")
    files = ["mesh_content.ply", "mesh_box.ply", "glints.npz", "sdf.npz"]
    folder.mark_done("mesh", "key", files, 1.0)
    return out


def test_a_run_has_all_its_layers(run):
    source = source_of(run)
    names = ["content", "box", "truth", "glints", "normals of glints"]
    assert [layer.name for layer in source.layers] == names
    assert [volume.name for volume in source.volumes] == ["distance", "matched filter"]
    assert [plane.name for plane in source.planes] == ["plane 0", "plane 1"]
    content, lines = source.layers[0], source.layers[4]
    assert np.linalg.norm(content.points, axis=1) == pytest.approx(RADIUS_M, abs=1e-6)
    assert np.linalg.norm(lines.points[1::2] - lines.points[::2], axis=1) == pytest.approx(0.004)
    moved = source.shifted(np.array([1.0, 0.0, 0.0]))
    assert moved.layers[0].points - content.points == pytest.approx(np.tile([1.0, 0, 0], (162, 1)))
    assert moved.volumes[0].grid.origin_m == pytest.approx((0.95, -0.05, -0.05))


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_slice_lies_where_its_values_do(axis):
    """Values that name their voxel come back as the grey of that voxel."""
    grid = Grid(origin_m=(0.1, 0.2, 0.3), spacing_m=0.01, shape=(3, 4, 5))
    values = np.arange(60.0).reshape(grid.shape)
    volume = Volume(name="v", grid=grid, values=values, colour_map="gray", limits=(0.0, 59.0))
    layer = volume.slice(axis, 2)
    for point, colour in zip(layer.points, layer.colours, strict=True):
        index = tuple(np.rint((point - grid.origin_m) / grid.spacing_m).astype(int))
        assert index[axis] == 2
        assert colour[0] == pytest.approx(255 * values[index] / 59, abs=1.5)
    sides = np.delete(np.array(grid.shape), axis)
    corners = layer.points[layer.faces]
    areas = np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    assert areas.sum() / 2 == pytest.approx(np.prod(sides - 1) * 1e-4)


def test_a_port_in_use_and_nothing_to_show_are_one_line(run, tmp_path, capsys):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(UserError, match=rf"port {port} cannot be used.*port {port + 1}"):
            require_free("127.0.0.1", port)
        pytest.importorskip("viser", reason="needs the extra geraf2[view]")
        assert main(["view", str(run), "--port", str(port)]) == 2
        assert "cannot be used" in capsys.readouterr().err
    assert main(["view", str(tmp_path)]) == 2
    assert "is no run folder" in capsys.readouterr().err
    assert main(["view", str(run), str(run), str(run)]) == 2


@pytest.fixture
def view(run):
    pytest.importorskip("viser", reason="needs the extra geraf2[view]")
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    made = LiveView([run, run], port=port)
    yield made
    made.stop()


class Client:
    """Speaks as viser's page does: sizes, compressed MessagePack, then raw numbers."""

    def __init__(self, port):
        self.msgpack = pytest.importorskip("msgspec").msgpack
        self.zstd = pytest.importorskip("zstandard")
        connect = pytest.importorskip("websockets.sync.client").connect
        protocol = f"viser-v{pytest.importorskip('viser').__version__}"
        self.socket = connect(f"ws://127.0.0.1:{port}", subprotocols=[protocol], max_size=None)
        camera = {"wxyz": [1, 0, 0, 0], "position": [1, 1, 1], "fov": 1.0, "near": 0.1, "far": 9.0}
        size = {"image_height": 100, "image_width": 100, "look_at": [0, 0, 0]}
        self.send("ViewerCameraMessage", **camera, **size, up_direction=[0, 0, 1])

    def send(self, kind, **values):
        self.socket.send(self.msgpack.encode({"type": kind, **values}))

    def set(self, control, value):
        self.send("GuiUpdateMessage", uuid=control._impl.uuid, updates={"value": value})

    def messages(self):
        data = self.socket.recv(timeout=30)
        n = int.from_bytes(data[8:16], "little")
        return self.msgpack.decode(self.zstd.decompress(data[16 : 16 + n]))["messages"]

    def until(self, done):
        """Messages up to one that will do."""
        seen = []
        while not any(done(message) for message in seen):
            seen += self.messages()
        return seen


def test_a_client_is_sent_every_layer_and_slices_when_it_asks(view):
    page = urllib.request.urlopen(view.url, timeout=20).read()
    assert b"<!doctype html>" in page[:200].lower()
    client = Client(view.port)
    wanted = set(view.layers)
    seen: set[str] = set()
    while not wanted <= seen:
        seen |= {message.get("name", "") for message in client.messages()}
    kinds = ("content", "box", "truth", "glints", "normals of glints", "planes/plane 1")
    assert {f"/{n} ball/{kind}" for n in (1, 2) for kind in kinds} <= seen
    client.set(view.controls["/2 ball/slice across"], "z")
    client.until(lambda message: message.get("name") == "/2 ball/slice")
    client.set(view.controls["/1 ball/planes"], 2)
    shown = "/1 ball/planes/plane 1"
    client.until(lambda m: m.get("name") == shown and "True" in str(m))
    assert not view.layers["/1 ball/planes/plane 0"].visible
    client.socket.close()
    assert view.ssh_line.startswith(f"ssh -N -L {view.port}:localhost:{view.port} ")


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
