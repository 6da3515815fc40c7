"""`geraf2 los` and `--los` with photos: priors from boxes, meshes, scans with holes, photos."""

import json
import shutil

import numpy as np
import pytest

from carton_photos import PhotosSpec, simulate_photos
from geraf2.apps.photos import los, training
from geraf2.apps.photos.config import GridStage, PhotoConfig
from geraf2.apps.photos.formats.images import read_image
from geraf2.cli.main import main
from geraf2.fields import SdfGrid
from geraf2.geometry.triangles import count_open_edges
from geraf2.io.mesh import TriangleMesh, read_mesh, write_mesh
from geraf2.pipeline.los_options import LosOptions
from geraf2.pipeline.prior import load_prior
from geraf2.scene import LosPrior, Wall
from helpers.console import the_error
from helpers.small_scene import FAST
from photo_writing import save_photos, write_image

BOX_SIDE = 0.20
WALL = Wall(size_m=(BOX_SIDE,) * 3, thickness_m=0.004, permittivity=1.6)


def run(*arguments):
    return main([str(argument) for argument in arguments])


def record_of(folder):
    return json.loads((folder / "los.json").read_text())


def box_mesh(size=(0.2, 0.1, 0.08)):
    prior = LosPrior.from_box(size)
    return TriangleMesh(vertices=prior.vertices, faces=prior.faces)


def test_a_box_of_three_sides(tmp_path):
    assert run("los", "0.2x0.1x0.08", tmp_path / "out", "--box-center", 0, 0, 0.04) == 0
    mesh = read_mesh(tmp_path / "out" / "los.ply")
    np.testing.assert_allclose(mesh.vertices.max(axis=0), [0.1, 0.05, 0.08], atol=1e-7)
    sdf = SdfGrid.load(tmp_path / "out" / "los.npz")
    np.testing.assert_allclose(sdf.sample(np.array([[0.0, 0.0, 0.04]])), [-0.04], atol=2e-3)
    record = record_of(tmp_path / "out")
    assert (record["unit"], record["kind"]) == ("m", "box")
    sidecar = json.loads((tmp_path / "out" / "los.ply.json").read_text())
    assert sidecar["unit"] == "metre"


def test_a_mesh_in_millimetres_and_another_frame(tmp_path):
    mesh = box_mesh()
    write_mesh(TriangleMesh(vertices=1e3 * mesh.vertices, faces=mesh.faces), tmp_path / "box.ply")
    move = np.array([[0.0, -1, 0, 0.1], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    np.savetxt(tmp_path / "move.txt", move)
    flags = ("--unit", "mm", "--to-radar", tmp_path / "move.txt")
    assert run("los", tmp_path / "box.ply", tmp_path / "out", *flags) == 0
    got = read_mesh(tmp_path / "out" / "los.ply").vertices
    np.testing.assert_allclose(got.max(axis=0), [0.15, 0.1, 0.04], atol=1e-6)
    np.testing.assert_allclose(got.min(axis=0), [0.05, -0.1, -0.04], atol=1e-6)


def test_a_scan_with_a_hole_is_closed_and_cut(tmp_path, capsys):
    mesh = box_mesh()
    write_mesh(TriangleMesh(vertices=mesh.vertices, faces=mesh.faces[1:]), tmp_path / "scan.ply")
    bounds = ("--bounds", "-inf", "-inf", -0.03, "inf", "inf", "inf")
    assert run("los", tmp_path / "scan.ply", tmp_path / "out", *bounds) == 0
    assert "has holes" in capsys.readouterr().err
    got = read_mesh(tmp_path / "out" / "los.ply")
    assert count_open_edges(got.faces) == 0
    np.testing.assert_allclose(got.vertices[:, 2].min(), -0.03, atol=1e-4)
    np.testing.assert_allclose(got.vertices[:, 2].max(), 0.04, atol=1e-4)


@pytest.fixture(scope="module")
def photo_folder(tmp_path_factory):
    """Twelve small photos of the box of the small scene."""
    folder = tmp_path_factory.mktemp("photos")
    spec = PhotosSpec(
        n_photos=12, size_px=(96, 72), focal_length_px=96.0, ring_elevations_deg=(0.0, 40.0)
    )
    save_photos(simulate_photos(spec, (WALL,), seed=0), folder)
    return folder


@pytest.fixture
def tiny_training(monkeypatch):
    """A training of seconds, whose surfaces are kept."""

    def tiny(preset, seed):
        del preset
        stages = (GridStage(n_longest=24, n_steps=20),)
        return PhotoConfig(stages=stages, rays_per_step=256, seed=seed)

    real, calls = training.train_neural_surface, []

    def counted(*arguments, **options):
        calls.append(real(*arguments, **options))
        return calls[-1]

    monkeypatch.setattr(los, "photo_config", tiny)
    monkeypatch.setattr(training, "train_neural_surface", counted)
    return calls


def moved_masks(photo_folder, folder):
    """The photos, as if the box had stood elsewhere in each."""
    shutil.copytree(photo_folder, folder)
    for mask in (folder / "masks").iterdir():
        shift = 12 if int(mask.stem[-1]) % 2 else -12
        write_image(mask, np.roll(read_image(mask).colour[:, :, 0], shift, axis=1))
    return folder


def test_photos_become_a_prior_once(photo_folder, tiny_training, tmp_path, capsys, monkeypatch):
    out = tmp_path / "los"
    assert run("los", photo_folder, out, "--hold-out", 6) == 0
    # Silhouettes are right after 20 steps, colours are not.
    assert "explains the photos badly: photos left out have" in capsys.readouterr().err
    record = record_of(out)
    assert record["kind"] == "photos"
    assert record["numbers"]["n_held_out"] == 2
    assert record["numbers"]["silhouette_iou"] > 0.9
    assert np.abs(np.array(record["size_m"]) - BOX_SIDE).max() < 0.05
    assert count_open_edges(read_mesh(out / "los.ply").faces) == 0
    assert (out / "views.png").is_file()
    assert not list(out.glob("training-*"))
    assert len(tiny_training) == 1

    # The same photos and settings are not trained again, but a damaged file is made again.
    assert run("los", photo_folder, out, "--hold-out", 6) == 0
    assert len(tiny_training) == 1
    (out / "los.ply").write_bytes(b"")
    assert run("los", photo_folder, out, "--hold-out", 6) == 0
    assert len(tiny_training) == 2
    assert count_open_edges(read_mesh(out / "los.ply").faces) == 0

    # A surface that is not that of its photos becomes no prior, and what was there stays.
    monkeypatch.setattr(los, "_train", lambda *_: tiny_training[-1])
    kept = {path.name: path.read_bytes() for path in out.iterdir()}
    capsys.readouterr()
    moved = moved_masks(photo_folder, tmp_path / "moved")
    assert run("los", moved, out, "--hold-out", 6, "--overwrite") == 2
    line = the_error(capsys)
    assert "the surface does not explain the photos: photos left out have" in line
    assert "and silhouettes overlap by" in line
    assert "refused.png" in line
    assert {name: (out / name).read_bytes() for name in kept} == kept
    assert (out / "refused.png").is_file()


def test_the_key_differs_with_photos_and_settings(photo_folder, tiny_training):
    def key(**flags):
        return los.read_photos(photo_folder, LosOptions(**flags)).key

    assert key() == key()
    others = ({"seed": 1}, {"hold_out": 4}, {"unit": "1.001"}, {"bounds": (-1, -1, -1, 1, 1, 1)})
    assert len({key(), *(key(**flags) for flags in others)}) == 1 + len(others)


@pytest.mark.slow
def test_reconstruct_with_photos(photo_folder, tiny_training, scene, tmp_path):
    out = tmp_path / "run"
    command = ("reconstruct", scene, out, "--los", photo_folder, *FAST, "--trust-los")
    assert run(*command) == 0
    assert (out / "los" / "los.ply").is_file()
    box = read_mesh(out / "mesh_box.ply")
    assert np.abs(np.ptp(box.vertices, axis=0) - BOX_SIDE).max() < 0.05
    page = (out / "report.html").read_text()
    assert "Line of sight" in page
    assert "Heat map" in page
    assert len(tiny_training) == 1
    # Trained once, even without --resume; a folder of `geraf2 los` is a prior, too.
    assert run(*command, "--no-report") == 0
    assert len(tiny_training) == 1
    prior = load_prior(out / "los")
    np.testing.assert_allclose(prior.vertices, read_mesh(out / "los" / "los.ply").vertices)


def test_photos_in_another_unit_are_refused_before_training(
    photo_folder, tiny_training, scene, tmp_path, capsys
):
    path = shutil.copytree(photo_folder, tmp_path / "photos") / "transforms.json"
    path.write_text(path.read_text().replace('"unit": "m"', '"unit": "mm"'))
    assert run("reconstruct", scene, tmp_path / "run", "--los", path.parent, *FAST) == 2
    assert "--unit" in the_error(capsys)
    assert not tiny_training
    assert not (tmp_path / "run").exists()


def test_a_scan_gives_the_prior_of_its_box(scene, tmp_path, capsys):
    out = tmp_path / "los"
    assert main(["los", str(scene), str(out)]) == 0
    assert "faces -x +x -y +y seen squarely" in capsys.readouterr().out
    record = json.loads((out / "los.json").read_text())
    assert record["kind"] == "radar"
    np.testing.assert_allclose(record["size_m"][:2], 0.2, atol=4e-3)
    assert record["numbers"]["faces"]["+x"]["seen"] == "squarely"


@pytest.mark.parametrize("sides", [["0.16", "0.12", "0.1"], ["0.16x0.12x0.1"], ["0.16, 0.12, 0.1"]])
def test_sides_of_a_box_are_given_in_any_usual_form(sides, tmp_path, capsys):
    assert main(["los", *sides, str(tmp_path / "los")]) == 0
    assert "160.0 x 120.0 x 100.0 mm" in capsys.readouterr().out
    if len(sides) == 1:  # as one word after a flag
        sides = sides[0].split()
    assert main(["plan", "--elevations-deg", "0", "--box", *sides]) == 0
    assert main(["los", "0.16", "0.12", str(tmp_path / "other")]) == 2
