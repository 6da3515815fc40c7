import numpy as np
import pytest

from geraf2.cli.main import main
from geraf2.io.mesh import Evidence, read_mesh
from geraf2.pipeline.reconstruction import load_run


def header(path):
    return path.read_bytes().partition(b"end_header")[0].decode()


def test_only_what_was_seen_is_exported(finished_run, tmp_path, capsys):
    assert main(["export", str(finished_run), str(tmp_path / "seen.ply"), "--only-seen"]) == 0
    whole, seen = load_run(finished_run).content_mesh, read_mesh(tmp_path / "seen.ply")
    assert 0 < len(seen.faces) < len(whole.faces)
    assert (seen.evidence == Evidence.SEEN).all()
    text = header(tmp_path / "seen.ply")
    for name in ("expected_error_m", "quality", "confidence"):
        assert f"property float {name}\n" in text
    assert str(tmp_path / "seen.ply") in capsys.readouterr().out


def test_glints_are_a_cloud_with_normals(finished_run, tmp_path):
    assert main(["export", str(finished_run), str(tmp_path / "g.ply"), "--glints"]) == 0
    glints = load_run(finished_run).glints
    data = (tmp_path / "g.ply").read_bytes()
    assert f"element vertex {len(glints)}\n" in header(tmp_path / "g.ply")
    body = data.partition(b"end_header\n")[2]
    rows = np.frombuffer(body, "<f4").reshape(len(glints), -1)
    np.testing.assert_allclose(rows[:, :3], glints.positions, atol=1e-6)
    np.testing.assert_allclose(rows[:, 3:6], glints.normals, atol=1e-6)


@pytest.mark.parametrize(
    ("name", "flags", "line"),
    [
        ("there.ply", [], "is there already; pass --overwrite"),
        ("g.glb", ["--glints"], "unknown kind of file, expected a name ending in .ply"),
        ("m.xyz", [], "expected a name ending in .ply or .glb or .stl"),
    ],
)
def test_what_cannot_be_exported_is_one_line(name, flags, line, finished_run, tmp_path, capsys):
    (tmp_path / "there.ply").write_text("mine")
    assert main(["export", str(finished_run), str(tmp_path / name), *flags]) == 2
    assert line in capsys.readouterr().err
    assert (tmp_path / "there.ply").read_text() == "mine"
