"""Commands as functions: what they return and report, and that they print nothing."""

import pytest

from geraf2.apps.importers.import_capture import import_capture
from geraf2.io.mesh import write_mesh
from geraf2.pipeline.events import Listener
from geraf2.pipeline.prior import load_prior
from geraf2.scene import LosPrior, Wall, load_capture
from helpers.synthetic import CAPTURE_JSON, point_capture, write_geraf_sens


class Heard(Listener):
    def __init__(self):
        self.steps, self.warnings = [], []
        self.warning = self.warnings.append

    def step(self, label):
        self.steps.append(label)
        return super().step(label)


def test_an_import_returns_its_findings_and_reports_notes(tmp_path, capfd):
    parameters = {k: v for k, v in CAPTURE_JSON.items() if k != "path_bias_m"}
    capture = point_capture(4)
    source = write_geraf_sens(tmp_path / "capture", capture, parameters=parameters)
    heard = Heard()
    first = import_capture("geraf-sens", str(source), tmp_path / "scene", listener=heard)
    assert heard.steps == ["checking", "finding the sign of the phase", "writing"]
    assert heard.warnings == list(first.notes)
    assert any("path_bias_m" in note for note in first.notes)
    assert (first.sign.sign, first.sign.is_positive, first.unchanged) == (-1, False, False)
    assert first.summary.n_antennas == sum(pose.n_antennas for pose in capture.poses)
    assert load_capture(first.scene).provenance["phase_sign_evidence"] == str(first.sign)
    assert import_capture("geraf-sens", source, tmp_path / "scene").unchanged
    assert capfd.readouterr() == ("", "")


def test_a_prior_comes_from_a_file_a_folder_or_a_box(tmp_path):
    box = load_prior((0.2, 0.1, 0.3), center_m=(0.0, 0.0, 0.1))
    write_mesh(box.mesh, tmp_path / "los.ply", frame="capture")
    for source in (tmp_path, str(tmp_path / "los.ply")):
        assert load_prior(source).bounds == pytest.approx(box.bounds, abs=1e-7)
    heard = Heard()
    walls = tuple(Wall(size_m=(s, s, s), thickness_m=0.004, permittivity=2.0) for s in (0.4, 0.25))
    fitted = load_prior((0.3, 0.3, 0.3), walls=walls, listener=heard)
    assert [wall.size_m for wall in fitted.walls] == [(0.3, 0.3, 0.3), (0.25, 0.25, 0.25)]
    assert len(heard.warnings) == 1
    assert LosPrior.from_box((0.2, 0.1, 0.3), (0.0, 0.0, 0.1)).mesh.faces.shape == (12, 3)
