"""What a run rules out, in the answer, its files and pages."""

import json

import numpy as np

from geraf2.apps.inspection.bodies import small_bodies
from geraf2.cli.main import main
from geraf2.echoes import Glints
from geraf2.io.verdict import Trust
from geraf2.report import write_report
from helpers.inspected import CUBES, measured_body, run_of
from helpers.run_folders import judge, record_run

REGIONS = [
    {"name": "in the box", "metal_mm": 5.2, "plastic_mm": 21.0, "unseen_share": 0.01},
    {"name": "below the content", "metal_mm": 8.6, "plastic_mm": None, "unseen_share": 0.2},
]


def test_what_was_ruled_out_is_told_everywhere(tmp_path, capsys):
    run = run_of(tmp_path / "run", *CUBES)
    record_run(run, "crate", numbers={"mesh": {"ruled_out": REGIONS}})
    assert main(["inspect", str(run)]) == 0
    line = "no metal ball above 5.2 mm in 95 % of the box, 8.6 mm below the content"
    assert line in capsys.readouterr().out
    assert json.loads((run / "inspection.json").read_text())["ruled_out"] == REGIONS
    report = write_report(run)
    for page in (run / "inspection.html", report):
        text = page.read_text()
        assert "What was ruled out" in text
        assert "<td>below the content</td><td>8.6</td><td>none</td><td>20</td>" in text
    assert f"N{line[1:]}" in report.read_text()
    judge(run, Trust.NOT_TO_BE_TRUSTED)
    main(["inspect", str(run)])
    assert "ruled out" not in capsys.readouterr().out
    assert json.loads((run / "inspection.json").read_text())["ruled_out"] == []
    assert "What was ruled out" not in write_report(run).read_text()


def test_echoes_that_belong_to_no_part_are_noted():
    bodies = [measured_body(CUBES[0], sigma_m=3e-4)]
    rng = np.random.default_rng(0)
    spots = np.array([[0.0, 0.0, 0.07], [0.04, 0.0, 0.07], bodies[0].mesh.vertices[0]])
    positions = np.repeat(spots, 4, axis=0) + 1e-3 * rng.standard_normal((12, 3))
    glints = Glints(
        positions=positions,
        normals=np.tile([0.0, 0.0, 1.0], (12, 1)),
        strengths=np.ones(12),
        poses=np.array([0, 0, 1, 1, *[2] * 4, *range(4)]),
        position_sigma_m=np.full(12, 1e-3),
        normal_sigma_rad=np.full(12, 0.1),
        probability=np.ones(12),
    )
    (text,) = small_bodies(bodies, glints)  # the second is seen from one plane
    assert "come from (0, 0, 70) mm: 4 glints of 2 planes" in text
    assert small_bodies(bodies, None) == []
