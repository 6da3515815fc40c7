import base64
import json
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from geraf2.io.mesh import Evidence
from geraf2.report.answer import answer_of
from geraf2.report.run_sections import losses, read_log
from geraf2.report.view3d import (
    Around,
    Attribute,
    content_attributes,
    scene_json,
    thin_mesh,
    view_scene,
)
from geraf2.report.view_layers import heat_map
from geraf2.scene import Grid
from helpers.glint_sets import glints_on_sphere
from helpers.solids import ball, joined


def unpacked(stored):
    """Read quantised numbers as the page does, written from the format."""
    values = stored["values"]
    kind = {"u1": np.uint8, "u2": "<u2", "u4": "<u4"}[values["type"]]
    whole = np.frombuffer(base64.b64decode(values["data"]), dtype=kind).astype(float)
    columns = whole.reshape(-1, len(stored["low"]))
    return np.array(stored["low"]) + np.array(stored["step"]) * columns


def test_positions_and_values_come_back_to_a_micrometre():
    mesh, values = ball(0.03), np.linspace(-7.3, 4.1, 642)
    scene = view_scene(mesh, [Attribute(label="error", values=values, unit="mm")])
    content = scene["meshes"][0]
    np.testing.assert_allclose(unpacked(content["positions"]), 1e3 * mesh.vertices, atol=1e-3)
    np.testing.assert_allclose(
        unpacked(content["attributes"][0]["values"])[:, 0], values, atol=1e-3
    )
    assert content["closed"]


@pytest.mark.parametrize("max_faces", [2000, 300])
def test_a_thinned_surface_is_nearly_the_same_one(max_faces):
    mesh = ball(0.03, subdivisions=4)
    kept, faces = thin_mesh(mesh.vertices, mesh.faces, max_faces)
    assert 0.3 * max_faces < len(faces) <= max_faces
    vertices = mesh.vertices[kept]
    made = trimesh.Trimesh(vertices=vertices, faces=faces, process=False)
    full = 4 / 3 * np.pi * 0.03**3
    assert made.volume == pytest.approx(full, rel=12 / max_faces + 0.02)
    # a chord as long as the longest edge lies at most edge^2 / (8 r) below the sphere
    longest = made.edges_unique_length.max()
    depth = 0.03 - np.linalg.norm(made.triangles_center, axis=1)
    assert depth.max() < longest**2 / (6 * 0.03) + 1e-5


def test_json_cannot_end_the_script_that_holds_it():
    text = scene_json({"name": "</script><b>"})
    assert "<" not in text
    assert json.loads(text) == {"name": "</script><b>"}


def test_attributes_are_what_is_known():
    content, outer, inner = ball(0.03, middle=(0.01, 0, 0)), ball(0.08), ball(0.075)
    box = joined(inner.with_faces(inner.faces[:, ::-1]), outer)  # a wall, with an inner side
    assert [a.label for a in content_attributes(content)] == []
    distances = np.full(len(content.vertices), -0.0015)
    found = content_attributes(
        content, glints=glints_on_sphere(0.03, 60), box=box, distances_m=distances
    )
    by_label = {a.label: a for a in found}
    assert set(by_label) == {"distance to the truth", "seen by the radar", "depth in the box"}
    assert by_label["distance to the truth"].limits == (-2.0, 2.0)
    depth = by_label["depth in the box"].values
    # the nearest and the farthest point of the ball from the box around it
    np.testing.assert_allclose([depth.min(), depth.max()], [40.0, 60.0], atol=0.8)


def test_pieces_are_parts_the_largest_first():
    small, large = ball(0.01, 2, (0.05, 0, 0)), ball(0.02, 3)
    both = joined(small, large)
    (part,) = content_attributes(both)
    assert part.classes == ("part 1 (80 % of the area)", "part 2 (20 % of the area)")
    assert set(part.values[: len(small.vertices)]) == {1.0}
    assert set(part.values[len(small.vertices) :]) == {0.0}
    answer = answer_of(both, None, {}, {})
    assert answer.found.startswith("2 separate pieces, 80 x 40 x 40 mm over all")


def test_the_answer_names_unseen_surface():
    content = ball(0.03)
    every = glints_on_sphere(0.03, 3000)
    sideways = every.select(np.abs(every.normals[:, 2]) < 0.5)
    numbers = {
        "box": {"by_radar": "box of 120 mm"},
        "outlines": {"outlines": 0},
        "calibration": {"applied": ["delay: 1 mm +- 0.1"], "left": ["axis: none"]},
    }
    answer = answer_of(content, sideways, numbers, {})
    assert answer.found == "One body, 60 x 60 x 60 mm, its centre at (0, 0, 0) mm."
    assert answer.corrected == ("delay",)
    assert answer.notes == ("Box of 120 mm.",)
    _, first, ends = answer.cards[-1].lines
    assert "of what faces up" in first
    assert ends == "These ends of the size had no echo: bottom and top."
    assert len(answer_of(content, every, {}, {}).cards[-1].lines) == 1
    assert "empty" in answer_of(content.with_faces(content.faces[:0]), every, {}, {}).found


def test_unseen_surface_is_split_by_what_it_rests_on():
    content = ball(0.03)
    kinds = np.select(
        [content.vertices[:, 2] > 0.015, content.vertices[:, 2] > 0.0],
        [Evidence.NOT_SEEN, Evidence.OUTLINE],
        Evidence.SEEN,
    ).astype(np.uint8)
    card = answer_of(replace(content, evidence=kinds), None, {}, {}).cards[-1]
    assert card.title == "Not seen"
    shares = dict(card.shares)
    # zones of a sphere are as large as they are high
    assert shares["outline"] == pytest.approx(0.25, abs=0.03)
    assert shares["not seen"] == pytest.approx(0.25, abs=0.03)
    outline, not_seen = (f"{100 * shares[name]:.0f} %" for name in ("outline", "not seen"))
    assert card.lines[0] == f"{outline} more rest on the outline of a shadow."
    assert card.value == not_seen


def test_a_volume_is_thinned_to_its_largest_values():
    grid = Grid(origin_m=(0.01, 0.02, 0.03), spacing_m=0.001, shape=(100, 40, 30))
    values = np.full(grid.shape, 1e-3)
    values[70, 20, 10] = 1.0
    scene = view_scene(ball(0.03), (), Around(volumes=[heat_map(values, grid)]))
    (volume,) = scene["volumes"]
    levels = np.frombuffer(base64.b64decode(volume["values"]["data"]), dtype=np.uint8)
    assert volume["shape"] == [34, 14, 10]
    peak = np.array(np.unravel_index(levels.argmax(), volume["shape"]))
    at = np.array(volume["origin"]) + volume["spacing"] * peak
    np.testing.assert_allclose(at, [80.0, 40.0, 40.0], atol=1.51)
    assert levels.max() == 255
    assert np.median(levels) == 0
    assert len(scene_json(scene)) < 0.3e6


def test_losses_are_read_from_a_log_with_broken_lines(tmp_path):
    steps = [(10, 1.0), (20, 0.5), (20, 0.4)]
    lines = [json.dumps({"event": "training", "step": s, "heatmap": v}) for s, v in steps]
    (tmp_path / "log.jsonl").write_text("\n".join([*lines, "{broken", "[]"]))
    assert losses(read_log(tmp_path)) == {"heatmap": [(10, 1.0), (20, 0.4)]}
