"""Meshes as CAD programs and scanners write them."""

import base64
import json
import struct

import numpy as np
import pytest

from geraf2.errors import UserError
from geraf2.geometry.triangles import count_open_edges, enclosed_volume_m3, face_areas
from geraf2.io.mesh import read_mesh

V = [(x, y, z) for z in (0, 1) for y in (0, 2) for x in (0, 3)]
QUADS = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (1, 3, 7, 5), (3, 2, 6, 7), (2, 0, 4, 6)]
MIXED = [*QUADS[:5], (2, 0, 4), (2, 4, 6)]


def volume(path):
    mesh = read_mesh(path)
    assert count_open_edges(mesh.faces) == 0
    return enclosed_volume_m3(mesh.vertices, mesh.faces)


def obj(vertices, faces, first=1):
    lines = ["v " + " ".join(map(str, v)) for v in vertices]
    return "\n".join([*lines, *("f " + " ".join(str(i + first) for i in f) for f in faces)]) + "\n"


OBJS = {
    "two parts of relative indices": obj(V, QUADS, -8)
    + obj([(x + 10, y, z) for x, y, z in V], QUADS, -8),
    "two parts of indices from one": obj(V, QUADS)
    + obj([(x + 10, y, z) for x, y, z in V], QUADS, 9),
    "normals and textures": obj(V, QUADS)
    + obj([(x + 10, y, z) for x, y, z in V], QUADS, 9)
    .replace(" 9", " 9/1/1")
    .replace(" 12", " 12//3"),
    "colours and a line that continues": obj(V, QUADS).replace("v 0 0 0", "v 0 0 0 .5 .5 .5")
    + obj([(x + 10, y, z) for x, y, z in V], QUADS, 9).replace("f 9 ", "f 9 \\\n"),
    "a name in another encoding": "o Geh\xe4use\n"
    + obj(V, QUADS)
    + obj([(x + 10, y, z) for x, y, z in V], QUADS, 9),
}


@pytest.mark.parametrize("name", OBJS)
def test_obj_of_two_parts(tmp_path, name):
    (tmp_path / "a.obj").write_bytes(OBJS[name].encode("latin-1"))
    assert volume(tmp_path / "a.obj") == pytest.approx(12.0)
    assert np.ptp(read_mesh(tmp_path / "a.obj").vertices, axis=0).tolist() == [13, 2, 1]


@pytest.mark.parametrize("line", ["f 0 1 2", "f 1 2 x", "v 1 2", "f 1 2 99", "f -99 1 2"])
def test_obj_lines_that_cannot_be_read_are_named(tmp_path, line):
    (tmp_path / "a.obj").write_text(obj(V, QUADS) + line + "\n")
    with pytest.raises(UserError, match=r"line 15|a vertex that is not there"):
        read_mesh(tmp_path / "a.obj")


# Outlines seen from above, counter-clockwise: an L, an arrow, a comb, a star.
ANGLES = np.linspace(0, 2 * np.pi, 10, endpoint=False)
OUTLINES = {
    "L": [(0, 0), (4, 0), (4, 1), (1, 1), (1, 3), (0, 3)],
    "arrow": [(0, 0), (2, 1), (0, 2), (0.5, 1)],
    "comb": [(0, 0), (5, 0), (5, 2), (4, 2), (4, 1), (3, 1), (3, 2), (2, 2), (2, 1), (1, 1), (1, 2),
             (0, 2)],
    "star": [((1 + k % 2) * np.cos(a), (1 + k % 2) * np.sin(a)) for k, a in enumerate(ANGLES)],
}  # fmt: skip


def area(outline):
    x, y = np.array(outline).T
    return 0.5 * float((x * np.roll(y, -1) - y * np.roll(x, -1)).sum())


def prism(outline):
    """Vertices and faces of an upright prism of height 1; the base is one polygon."""
    n = len(outline)
    vertices = [(x, y, z) for z in (0, 1) for x, y in outline]
    sides = [(k, (k + 1) % n, n + (k + 1) % n, n + k) for k in range(n)]
    return vertices, [tuple(range(n))[::-1], tuple(range(n, 2 * n)), *sides]


@pytest.mark.parametrize("name", OUTLINES)
@pytest.mark.parametrize("start", range(4))
def test_concave_polygons_are_cut_inside(tmp_path, name, start):
    outline = OUTLINES[name][start:] + OUTLINES[name][:start]
    vertices, faces = prism(outline)
    (tmp_path / "a.obj").write_text(obj(vertices, faces))
    mesh = read_mesh(tmp_path / "a.obj")
    assert volume(tmp_path / "a.obj") == pytest.approx(area(outline))
    # A triangle outside of the polygon would add to the area.
    perimeter = np.linalg.norm(np.array(outline) - np.roll(outline, 1, axis=0), axis=1).sum()
    total = face_areas(mesh.vertices[mesh.faces]).sum()
    assert total == pytest.approx(2 * area(outline) + perimeter)


def stl(n=None, head=b"made by hand", tail=b""):
    corners = np.array(V, dtype="<f4")
    triangles = [t for a, b, c, d in QUADS for t in ((a, b, c), (a, c, d))]
    body = b"".join(bytes(12) + corners[list(t)].tobytes() + bytes(2) for t in triangles)
    count = len(triangles) if n is None else n
    return head.ljust(80) + struct.pack("<I", count & 0xFFFFFFFF) + body + tail


STLS = {
    "plain": stl(),
    "bytes after the end": stl(tail=b"colour of this part" * 9),
    "a few bytes after the end": stl(tail=b"\0\0"),
    "count of -1": stl(-1),
    "count of 0": stl(0),
    "named solid": stl(head=b"solid made by CAD"),
    "named solid facet": stl(head=b"solid facet of a\0"),
}


@pytest.mark.parametrize("name", STLS)
def test_binary_stl_of_any_writer(tmp_path, name):
    (tmp_path / "a.stl").write_bytes(STLS[name])
    assert volume(tmp_path / "a.stl") == pytest.approx(6.0)


def test_an_stl_that_is_cut_off_is_refused(tmp_path):
    (tmp_path / "a.stl").write_bytes(stl()[:-60])
    with pytest.raises(UserError, match="states 12 triangles, 10 can be read"):
        read_mesh(tmp_path / "a.stl")


@pytest.mark.parametrize("change", [str, str.upper])
def test_text_stl_of_two_solids(tmp_path, change):
    def solid(name, shift):
        lines = [f"solid {name}"]
        for a, b, c, d in QUADS:
            for t in ((a, b, c), (a, c, d)):
                rows = "".join(f"  vertex {V[k][0] + shift} {V[k][1]} {V[k][2]:e}\n" for k in t)
                lines.append(f" facet normal 0 0 0\n outer loop\n{rows} endloop\n endfacet")
        return "\n".join([*lines, f"endsolid {name}", ""])

    text = change(solid("a", 0) + solid("b", 10))
    (tmp_path / "a.stl").write_text(text)
    assert volume(tmp_path / "a.stl") == pytest.approx(12.0)
    (tmp_path / "a.stl").write_text(text[: text.rindex(change("vertex"))])
    with pytest.raises(UserError, match="states 24 triangles, 12 can be read"):
        read_mesh(tmp_path / "a.stl")


def ply(encoding, faces, name="face", length="uchar"):
    head = (
        f"ply\nformat {encoding} 1.0\ncomment by hand\nelement vertex 8\nproperty float x\n"
        f"property float y\nproperty float z\nproperty uchar red\nelement {name} {len(faces)}\n"
        f"property list {length} int vertex_indices\nend_header\n"
    )
    if encoding == "ascii":
        rows = ["{} {} {} 7".format(*v) for v in V]
        rows += [f"{len(f)} " + " ".join(map(str, f)) for f in faces]
        return (head + "\n".join(rows) + "\n").encode()
    order = "<" if "little" in encoding else ">"
    data = b"".join(struct.pack(order + "fffB", *v, 7) for v in V)
    code = {"uchar": "B", "int": "i"}[length]
    for face in faces:
        data += struct.pack(f"{order}{code}{len(face)}i", len(face), *face)
    return head.encode() + data


ENCODINGS = ["ascii", "binary_little_endian", "binary_big_endian"]


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("faces", [QUADS, MIXED], ids=["quads", "mixed"])
@pytest.mark.parametrize("tail", [b"", b"\n\n"])
def test_ply_of_any_polygons(tmp_path, encoding, faces, tail):
    (tmp_path / "a.ply").write_bytes(ply(encoding, faces) + tail)
    assert volume(tmp_path / "a.ply") == pytest.approx(6.0)


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_ply_of_strips(tmp_path, encoding):
    # The four sides as one strip, then bottom and top.
    sides = [4, 0, 5, 1, 7, 3, 6, 2, 4, 0]
    data = ply(encoding, [[*sides, -1, *[0, 2, 1, 3], -1, *[4, 5, 6, 7]]], "tristrips", "int")
    (tmp_path / "a.ply").write_bytes(data)
    assert abs(volume(tmp_path / "a.ply")) == pytest.approx(6.0)


def test_vertices_beside_lists_of_different_lengths_are_no_integers(tmp_path):
    properties = [*(f"property float {axis}" for axis in "xyz"), "property list uchar int near"]
    head = ["ply", "format ascii 1.0", "element vertex 3", *properties, "element face 1"]
    head += ["property list uchar int vertex_index", "end_header"]
    rows = ["0.5 0 0 1 2", "1.5 0 0 2 0 2", "0 1.25 0 0", "3 0 1 2"]
    (tmp_path / "a.ply").write_text("\n".join([*head, *rows]) + "\n")
    vertices = read_mesh(tmp_path / "a.ply").vertices
    np.testing.assert_allclose(vertices, [[0.5, 0, 0], [1.5, 0, 0], [0, 1.25, 0]])


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("faces", [QUADS, MIXED], ids=["quads", "mixed"])
def test_a_ply_that_is_cut_off_names_its_rows(tmp_path, encoding, faces):
    data = ply(encoding, faces)
    for cut in (2, 30):
        (tmp_path / "a.ply").write_bytes(data[:-cut])
        with pytest.raises(UserError, match=f"lacks face rows, expected {len(faces)}, got"):
            read_mesh(tmp_path / "a.ply")


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("format ascii", "format any"),
        ("property float x", "property strange x"),
        ("element vertex 8", "element vertex many"),
        ("end_header", "end"),
        ("property float z", "property float w"),
        ("0 0 0 7", "0 nan. 0 7"),
    ],
)
def test_a_ply_with_a_broken_header_is_refused(tmp_path, old, new):
    (tmp_path / "a.ply").write_bytes(ply("ascii", QUADS).replace(old.encode(), new.encode(), 1))
    with pytest.raises(UserError, match="cannot read the mesh"):
        read_mesh(tmp_path / "a.ply")


@pytest.mark.parametrize(
    ("old", "new", "line"),
    [
        ("0 0 0 7\n", "0 0 0 7 255\n", "line 12 has 5 words, the header states 4"),
        ("4 0 ", "4 0 0 ", "line 20 has 6 words, the header states 5"),
        ("", "1 2 3\n", "line 26 stands behind the last row"),
    ],
)
def test_rows_that_differ_from_the_header_are_named(tmp_path, old, new, line):
    text = ply("ascii", QUADS).decode()
    (tmp_path / "a.ply").write_text(text.replace(old, new, 1) if old else text + new)
    with pytest.raises(UserError, match=line):
        read_mesh(tmp_path / "a.ply")


@pytest.mark.parametrize("encoding", ENCODINGS[1:])
def test_bytes_behind_the_last_row_are_refused(tmp_path, encoding):
    (tmp_path / "a.ply").write_bytes(ply(encoding, QUADS) + b"\x01\x02\x03")
    with pytest.raises(UserError, match="3 bytes stand behind the last row"):
        read_mesh(tmp_path / "a.ply")


# A box of 2 x 3 x 4 cm whose corners are integers from 0 or -n to n.
@pytest.mark.parametrize("kind", ["i1", "u1", "i2", "u2"])
@pytest.mark.parametrize("suffix", ["glb", "gltf"])
def test_normalised_integers_of_gltf_are_parts_of_one(tmp_path, kind, suffix):
    top, signed = np.iinfo(kind).max, kind[0] == "i"
    corners = np.array(V, dtype=float) / np.max(V, axis=0)  # 0 or 1
    integers = np.rint((2 * corners - 1 if signed else corners) * top).astype(kind)
    rows = np.zeros((8, 4), dtype=kind)  # rows are padded to four bytes
    rows[:, :3] = integers
    faces = np.array([[f[0], f[k], f[k + 1]] for f in QUADS for k in (1, 2)], dtype="<u2")
    data = faces.tobytes() + rows.tobytes()
    size = 0.01 * np.max(V, axis=0) / (2 if signed else 1)
    content = {
        "asset": {"version": "2.0"},
        "extensionsRequired": ["KHR_mesh_quantization"],
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "scale": size.tolist()}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 1}, "indices": 0}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5123, "count": 36, "type": "SCALAR"},
            {
                "bufferView": 1,
                "componentType": {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123}[kind],
                "normalized": True,
                "count": 8,
                "type": "VEC3",
                "min": integers.min(axis=0).tolist(),
                "max": integers.max(axis=0).tolist(),
            },
        ],
        "bufferViews": [
            {"buffer": 0, "byteLength": faces.nbytes},
            {
                "buffer": 0,
                "byteOffset": faces.nbytes,
                "byteLength": rows.nbytes,
                "byteStride": rows.strides[0],
            },
        ],
        "buffers": [{"byteLength": len(data)}],
    }
    path = tmp_path / f"a.{suffix}"
    if suffix == "gltf":
        content["buffers"][0]["uri"] = "data:application/octet-stream;base64," + base64.b64encode(
            data
        ).decode("ascii")
        path.write_text(json.dumps(content))
    else:
        text = json.dumps(content).encode()
        text += b" " * (-len(text) % 4)
        data += b"\0" * (-len(data) % 4)
        chunks = struct.pack("<I4s", len(text), b"JSON") + text
        chunks += struct.pack("<I4s", len(data), b"BIN\0") + data
        path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)
    mesh = read_mesh(path)
    x, z, y = 0.01 * np.max(V, axis=0)  # +Y up in the file
    assert np.ptp(mesh.vertices, axis=0) == pytest.approx([x, y, z], rel=0.01)
