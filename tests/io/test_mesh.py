import json

import numpy as np
import pytest
import trimesh
from PIL import Image

from geraf2.errors import UserError
from geraf2.geometry.triangles import enclosed_volume_m3
from geraf2.io.mesh import Evidence, TriangleMesh, read_mesh, write_mesh
from geraf2.io.mesh_colours import error_colours, to_linear
from geraf2.scene import LosPrior


@pytest.fixture
def box():
    prior = LosPrior.from_box((0.2, 0.3, 0.4), (0.01, 0.02, 0.03))
    error = np.linspace(0.0, 0.006, len(prior.vertices))
    codes = (np.arange(len(prior.vertices)) % len(Evidence)).astype(np.uint8)
    return TriangleMesh(
        vertices=prior.vertices, faces=prior.faces, expected_error_m=error, evidence=codes
    )


def test_ply_round_trip_keeps_geometry_winding_and_errors(box, tmp_path):
    write_mesh(box, tmp_path / "box.ply")
    back = read_mesh(tmp_path / "box.ply")
    # float32 coordinates: half an ulp of 0.23 m is 7.5e-9 m
    np.testing.assert_allclose(back.vertices, box.vertices, atol=1e-8)
    np.testing.assert_array_equal(back.faces, box.faces)
    np.testing.assert_allclose(back.expected_error_m, box.expected_error_m, rtol=1e-7)
    np.testing.assert_array_equal(back.evidence, box.evidence)
    assert back.evidence.dtype == np.uint8
    volume_m3 = enclosed_volume_m3(back.vertices, back.faces)
    assert volume_m3 == pytest.approx(0.2 * 0.3 * 0.4, rel=1e-6)


@pytest.mark.parametrize("encoding", ["ascii", "binary"])
def test_errors_of_a_ply_with_more_columns_are_kept(box, tmp_path, encoding):
    foreign = trimesh.Trimesh(box.vertices, box.faces, process=False)
    # doubles and wider integers, behind the normals
    foreign.vertex_attributes["expected_error_m"] = box.expected_error_m
    foreign.vertex_attributes["evidence"] = box.evidence.astype(np.int32)
    data = foreign.export(file_type="ply", encoding=encoding, vertex_normal=True)
    (tmp_path / "box.ply").write_bytes(data)
    back = read_mesh(tmp_path / "box.ply")
    # text: eight digits
    np.testing.assert_allclose(back.expected_error_m, box.expected_error_m, atol=1e-8)
    np.testing.assert_array_equal(back.evidence, box.evidence)


# Machado, Oliveira and Fernandes 2009: dichromats, in linear light.
@pytest.mark.parametrize(
    "sight",
    [
        np.eye(3),
        [[0.152, 1.053, -0.205], [0.115, 0.786, 0.099], [-0.004, -0.048, 1.052]],
        [[0.367, 0.861, -0.228], [0.280, 0.673, 0.047], [-0.012, 0.043, 0.969]],
        [[1.256, -0.077, -0.179], [-0.078, 0.931, 0.148], [0.005, 0.691, 0.304]],
    ],
)
def test_larger_errors_are_darker_for_every_kind_of_colour_vision(sight):
    colours = error_colours(np.linspace(0.0, 0.005, 26), 26)
    seen = np.clip(to_linear(colours / 255.0) @ np.transpose(sight), 0.0, 1.0)
    np.testing.assert_array_equal(error_colours(np.array([0.02]), 1), colours[-1:])
    levels = np.cbrt(seen @ [0.2126, 0.7152, 0.0722])
    assert (np.diff(levels) < 0).all()
    assert levels[0] - levels[-1] > 0.5


@pytest.mark.parametrize(
    ("name", "values"),
    [("evidence", [0, 7]), ("expected_error_m", [-1.0, np.nan])],
)
def test_a_ply_with_columns_of_another_meaning_is_a_mesh_without_errors(
    box, tmp_path, name, values
):
    foreign = trimesh.Trimesh(box.vertices, box.faces, process=False)
    foreign.vertex_attributes[name] = np.resize(values, len(box.vertices))
    foreign.export(tmp_path / "box.ply")
    back = read_mesh(tmp_path / "box.ply")
    assert back.expected_error_m is None
    assert back.evidence is None


def test_glb_is_y_up_for_others_and_comes_back_z_up(box, tmp_path):
    write_mesh(box, tmp_path / "box.glb")
    seen_by_others = trimesh.load(tmp_path / "box.glb", force="mesh", process=False)
    # the frame's height, 0.4 m along z about 0.03, lies along glTF's y
    np.testing.assert_allclose(seen_by_others.bounds[:, 1], [-0.17, 0.23], atol=1e-7)
    assert seen_by_others.volume == pytest.approx(0.2 * 0.3 * 0.4, rel=1e-6)
    back = read_mesh(tmp_path / "box.glb")
    np.testing.assert_allclose(back.vertices, box.vertices, atol=1e-7)
    (geometry,) = trimesh.load(tmp_path / "box.glb", process=False).geometry.values()
    carried = {name: values.reshape(-1) for name, values in geometry.vertex_attributes.items()}
    np.testing.assert_allclose(carried["_EXPECTED_ERROR_M"], box.expected_error_m, rtol=1e-7)
    np.testing.assert_array_equal(carried["_EVIDENCE"], box.evidence)


@pytest.mark.parametrize("kind", ["ply", "glb", "stl"])
def test_a_mesh_without_triangles_is_written(tmp_path, kind):
    empty = TriangleMesh(vertices=np.zeros((0, 3)), faces=np.zeros((0, 3), dtype=int))
    write_mesh(empty, tmp_path / f"m.{kind}")
    with pytest.raises(UserError):
        read_mesh(tmp_path / f"m.{kind}")


@pytest.mark.parametrize("name", ["m.ply", "m.glb"])
def test_sidecar_maps_file_coordinates_to_the_frame(box, tmp_path, name):
    write_mesh(box, tmp_path / name, frame="turntable")
    sidecar = json.loads((tmp_path / f"{name}.json").read_text())
    assert sidecar["unit"] == "metre"
    assert sidecar["frame"] == "turntable"
    assert sidecar["n_faces"] == 12
    raw = trimesh.load(tmp_path / name, force="mesh", process=False)
    in_frame = trimesh.transform_points(raw.vertices, np.array(sidecar["frame_from_file"]))
    np.testing.assert_allclose(in_frame, box.vertices, atol=1e-7)


def _with_texture(box, path):
    """Mesh file whose material names texture.png."""
    image = Image.new("RGB", (4, 4))
    material = trimesh.visual.material.SimpleMaterial(image=image)
    uv = np.zeros((len(box.vertices), 2))
    visual = trimesh.visual.TextureVisuals(uv=uv, image=image, material=material)
    textured = trimesh.Trimesh(box.vertices, box.faces, visual=visual, process=False)
    if path.suffix == ".gltf":
        for name, data in textured.export(file_type="gltf").items():
            (path.parent / name.replace("model.gltf", path.name)).write_bytes(data)
    else:
        textured.export(path)
    if path.suffix == ".ply":
        comment = b"\ncomment TextureFile texture.png\nelement vertex"
        path.write_bytes(path.read_bytes().replace(b"\nelement vertex", comment, 1))
    if path.suffix == ".gltf":
        tree = json.loads(path.read_text())
        tree["images"] = [{"uri": "texture.png"}]
        path.write_text(json.dumps(tree))


@pytest.mark.parametrize("kind", ["ply", "obj", "gltf", "glb"])
@pytest.mark.parametrize("exists", [True, False])
def test_materials_are_not_opened(box, tmp_path, monkeypatch, caplog, kind, exists):
    _with_texture(box, tmp_path / f"m.{kind}")
    if exists:
        Image.new("RGB", (4, 4)).save(tmp_path / "texture.png")
    opened = []
    monkeypatch.setattr(Image, "open", lambda *arguments, **_: opened.append(arguments))
    assert read_mesh(tmp_path / f"m.{kind}").faces.shape == (12, 3)
    assert opened == []
    assert caplog.records == []
