"""A session of planes: the result of the whole scan, at any moment, after any stop."""

import os
import signal
import subprocess
import sys
import textwrap
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import geraf2
from geraf2 import examples
from geraf2.constants import SPEED_OF_LIGHT_M_PER_S
from geraf2.errors import UserError
from geraf2.io.run_folder import RunFolder
from geraf2.io.verdict import Trust
from geraf2.pipeline.events import Listener
from geraf2.scene.store import save_capture
from geraf2.surfaces import FitConfig
from geraf2.surfaces.refinement import RefineConfig
from helpers.run_folders import VERDICTS

COARSE = geraf2.FastPreset(fit=FitConfig(spacing_m=0.01))
QUICK = geraf2.RunOptions(calibrate="no", trust_los=True)
"""A scan without errors has the same surface without these steps, in a third of the time."""


def _about(capture):
    return replace(capture, poses=())


def _session(capture, out=None, **more):
    return geraf2.Session(_about(capture), examples.BOX_M, COARSE, out, **more)


def test_the_end_is_the_reconstruction_of_the_whole_scan(capture, whole, tmp_path):
    with _session(capture, tmp_path / "out") as session:
        for number, pose in enumerate(capture.poses):
            session.add(pose)
            assert number not in (2, 5) or len(session.result.content_mesh.faces)
        result = session.finish()
        n_imaged = session.n_imaged
    assert n_imaged == len(capture.poses)  # each once
    assert np.array_equal(result.content_mesh.faces, whole.content_mesh.faces)
    assert result.content_mesh.vertices == pytest.approx(whole.content_mesh.vertices, abs=1e-9)
    # The folder of its planes is an ordinary scene, and that of the session an ordinary run.
    again = geraf2.reconstruct(tmp_path / "out" / "scene", examples.BOX_M, COARSE)
    assert again.content_mesh.vertices == pytest.approx(whole.content_mesh.vertices, abs=1e-9)
    assert geraf2.load_run(tmp_path / "out").run.scene_digest == again.run.scene_digest


def test_the_result_of_best_is_that_of_the_whole_scan(capture):
    fine = geraf2.BestPreset(refine=RefineConfig(fit=COARSE.fit))
    few = replace(capture, poses=capture.poses[::2])
    with geraf2.Session(_about(few), examples.BOX_M, fine, options=QUICK) as session:
        for pose in few.poses[:2]:
            session.add(pose)
        assert len(session.result.content_mesh.faces)
        before = session.n_imaged
        session.add(few.poses[2])
        assert len(session.result.content_mesh.faces)
        assert session.n_imaged == before + 1
        result = session.finish()
    whole = geraf2.reconstruct(few, examples.BOX_M, fine, options=QUICK)
    assert result.content_mesh.vertices == pytest.approx(whole.content_mesh.vertices, abs=1e-9)


def test_the_order_of_the_planes_does_not_matter(capture, whole):
    truth = examples.small_capture()[1]
    with _session(capture, options=QUICK) as session:
        for number in (3, 0, 5, 1, 4, 2):
            session.add(capture.poses[number])
        result = session.finish()
    found, wanted = (
        geraf2.evaluate(run, truth, n_samples=4000, report=False) for run in (result, whole)
    )
    assert found.scores[1].threshold_m == 0.005
    assert found.scores[1].f1 == pytest.approx(wanted.scores[1].f1, abs=0.002)
    assert (
        result.run.stages["glints"].numbers["n_glints"]
        == (whole.run.stages["glints"].numbers["n_glints"])
    )


def test_without_a_prior_the_box_is_found_as_of_the_whole_scan(capture):
    with geraf2.Session(_about(capture), None, COARSE) as session:
        for number, pose in enumerate(capture.poses):
            session.add(pose)
            if number in (0, 3):
                with suppress(UserError):  # no box is seen yet
                    _ = session.result
        result = session.finish()
    whole = geraf2.reconstruct(capture, None, COARSE)
    assert result.content_mesh.vertices == pytest.approx(whole.content_mesh.vertices, abs=1e-9)


def test_done_is_a_statement_about_the_area(capture, monkeypatch):
    monkeypatch.setattr(RunFolder, "verdict", property(lambda _: VERDICTS[Trust.RELIABLE]))
    with _session(capture) as session:
        with pytest.raises(UserError, match="has no plane yet"):
            _ = session.result
        assert not session.reaches("expected 100 mm over 1 %")
        for pose in capture.poses[:3]:
            session.add(pose)
        error_m = session.result.content_mesh.expected_error_m
        assert session.reaches(f"expected {1e3 * error_m.max() + 1:.3f} mm over 100 %")
        assert not session.reaches(f"expected {1e3 * error_m.min():.4f} mm over 100 %")


class _Heard(Listener):
    def __init__(self):
        self.warnings = []

    def warning(self, text):
        self.warnings.append(text)


def test_a_wrong_plane_is_refused_and_the_session_continues(capture, tmp_path):
    heard = _Heard()
    first, second = capture.poses[:2]
    with _session(capture, tmp_path / "out", listener=heard) as session:
        session.add(first, times_s=10.0 + np.arange(first.n_antennas))
        refused = {
            "is plane 0 again": replace(first, name="other", angle_deg=77.0),
            "another radar, expected 32 samples, got 16": replace(
                second, signal=second.signal[:, :16]
            ),
            "are NaN or infinite": replace(second, signal=second.signal * np.nan),
            "have 0 antennas": second.select(slice(0)),
        }
        for text, pose in refused.items():
            with pytest.raises(UserError, match=text):
                session.add(pose)
        with pytest.raises(UserError, match="times that go back"):
            session.add(second, times_s=-np.arange(float(second.n_antennas)))
        with pytest.raises(UserError, match="one for each antenna"):
            session.add(second, times_s=[1.0])
        assert len(session) == 1
        session.add(second, times_s=np.arange(second.n_antennas) / 1e3)
        assert [text for text in heard.warnings if "older than the last" in text]
        assert len(session) == 2
        assert len(session.result.content_mesh.faces)


def test_what_a_session_cannot_do_is_refused_at_once(capture, tmp_path):
    with pytest.raises(UserError, match="leaves no plane out"):
        _session(capture, options=geraf2.RunOptions(hold_out=(60.0,)))
    with (
        _session(capture, tmp_path / "out"),
        pytest.raises(UserError, match="another command is writing into this folder"),
    ):
        _session(capture, tmp_path / "out")
    _session(capture, tmp_path / "out").close()


KILLED = """
import sys
from pathlib import Path
from dataclasses import replace
import geraf2
from geraf2 import examples
from geraf2.surfaces import FitConfig
from geraf2.surfaces.refinement import RefineConfig

capture = geraf2.load_capture(sys.argv[1])
coarse = geraf2.FastPreset(fit=FitConfig(spacing_m=0.01))
quick = geraf2.RunOptions(calibrate="no", trust_los=True)
about = replace(capture, poses=())
session = geraf2.Session(about, examples.BOX_M, coarse, sys.argv[2], options=quick)
for pose in capture.poses:
    session.add(pose)
    if len(session) > 2:
        session.result
    print(len(session), flush=True)
"""


def test_a_killed_session_continues_from_its_last_plane(capture, whole, tmp_path):
    save_capture(capture, tmp_path / "scene")
    command = [sys.executable, "-c", textwrap.dedent(KILLED), tmp_path / "scene", tmp_path / "out"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as child:
        while child.stdout.readline().strip() != "3":
            assert child.poll() is None
        os.kill(child.pid, signal.SIGKILL)
    with _session(capture, tmp_path / "out", options=QUICK) as session:
        n_planes = len(session)
        assert n_planes >= 3
        assert capture.poses[n_planes - 1] in session
        for pose in capture.poses[n_planes:]:
            session.add(pose)
        result = session.finish()
    assert result.content_mesh.vertices == pytest.approx(whole.content_mesh.vertices, abs=1e-9)


def test_samples_are_on_disk_not_in_memory(capture):
    """A plane of 50 MB, of which a part is kept only while it is used."""
    pose = capture.poses[0]
    n_samples = 16_000
    signal = np.tile(pose.signal, (1, n_samples // pose.signal.shape[1]))
    waveform = replace(capture.waveform, n_samples=n_samples, sample_rate_hz=1e9)
    with geraf2.Session(waveform, examples.BOX_M, COARSE) as session:
        before = _anonymous_bytes()
        session.add(replace(pose, signal=signal))
        assert np.array_equal(session.capture.poses[0].signal, signal)
        assert _anonymous_bytes() - before < 0.5 * signal.nbytes


def _anonymous_bytes():
    with Path("/proc/self/status").open() as lines:
        return next(1024 * int(line.split()[1]) for line in lines if line.startswith("RssAnon"))


def test_a_plane_with_leakage_is_imaged_once_more_not_all_planes_again(capture):
    """The leakage of the planes before is subtracted from the next one."""
    delay_s = (capture.waveform.path_bias_m + 0.03) / SPEED_OF_LIGHT_M_PER_S
    leakage = np.exp(-2j * np.pi * capture.waveform.frequencies_hz * delay_s)
    poses = [
        replace(pose, signal=(pose.signal + 10.0 * leakage).astype(np.complex64))
        for pose in (
            *capture.poses,
            replace(capture.poses[0], signal=1.1j * capture.poses[0].signal),
        )
    ]
    with _session(capture) as session:
        for pose in poses[:6]:
            session.add(pose)
        assert len(session.result.content_mesh.faces)
        before = session.n_imaged
        session.add(poses[6])
        assert len(session.result.content_mesh.faces)
        assert session.result.run.stages["calibration"].numbers["applied"]
        assert session.n_imaged == before + 1
