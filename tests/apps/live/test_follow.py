"""Folders that grow while they are read, in both layouts, with what goes wrong in them."""

import json
import os
import threading
import time
from dataclasses import replace

import numpy as np
import pytest

import geraf2
from geraf2 import examples
from geraf2.apps.live.follow import LiveOptions, follow
from geraf2.io.growing_scene import GrowingScene
from geraf2.io.run_folder import RunFolder
from geraf2.io.verdict import Trust
from geraf2.pipeline.prior import PriorSource
from geraf2.scene.store import manifest_of
from geraf2.surfaces import FitConfig
from helpers.run_folders import VERDICTS
from helpers.synthetic import CAPTURE_JSON, write_frame

COARSE = geraf2.FastPreset(fit=FitConfig(spacing_m=0.01))
BOX = PriorSource(box=examples.BOX_M)
QUICK = LiveOptions(idle_s=0.5, report=False)


def _growing(capture, path, poses=(), announced=()):
    """Scene that grows, with its first poses; announced: entries of the provenance."""
    provenance = {**capture.provenance, **dict(announced)}
    scene = GrowingScene(path, manifest_of(replace(capture, poses=(), provenance=provenance)))
    for pose in poses:
        scene.append(pose)
    return scene


def _write_half_a_frame(folder, pose):
    write_frame(folder, pose)
    (folder / "adci.npy").unlink()


def _write_capture_json(folder, **more):
    values = CAPTURE_JSON | {"box_size_m": [list(examples.BOX_M)]} | more
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "capture.json").write_text(json.dumps(values))


def _settle(folder):
    """Let files be as old as those that nobody writes to."""
    for file in folder.rglob("*"):
        os.utime(file, (time.time() - 60.0,) * 2)


def _followed(source, out, ending=QUICK, listener=None):
    reports = []
    outcome = follow(
        source, out, BOX, COARSE, ending=ending, listener=listener, on_plane=reports.append
    )
    return outcome, reports


class Heard(geraf2.Listener):
    """Keeps the texts of findings."""

    def __init__(self):
        self.texts = []

    def findings(self, findings):
        self.texts += [str(finding) for finding in findings]


def test_a_scene_that_was_written_whole_ends_with_its_last_plane(capture, tmp_path):
    geraf2.save_capture(replace(capture, poses=capture.poses[:2]), tmp_path / "scan")
    ending = replace(QUICK, idle_s=600.0)
    outcome, _ = _followed(tmp_path / "scan", tmp_path / "out", ending)
    assert outcome.reason == "all 2 planes of the scan came"


def test_a_scene_that_grows_ends_as_its_reconstruction(capture, whole, tmp_path, monkeypatch):
    """It is written at a speed of its own, from before there is a folder."""
    monkeypatch.setattr(RunFolder, "verdict", property(lambda _: VERDICTS[Trust.RELIABLE]))
    heard = Heard()

    def play():
        time.sleep(0.5)
        announced = {"n_planes": str(len(capture.poses))}
        scene = _growing(capture, tmp_path / "scene", announced=announced)
        for pose in capture.poses:
            scene.append(pose)
            time.sleep(0.1)

    player = threading.Thread(target=play)
    player.start()
    ending = LiveOptions(idle_s=60.0, report=True)
    outcome, reports = _followed(tmp_path / "scene", tmp_path / "out", ending, heard)
    player.join()
    assert len([text for text in heard.texts if "Nyquist" in text]) == 1  # of all updates
    assert outcome.reason == "all 6 planes of the scan came"
    assert [report.plane for report in reports] == [1, 2, 3, 4, 5, 6]
    assert all(report.n_peaks > 0 and report.seconds > 0 for report in reports)
    assert reports[-1].seen_share > reports[0].seen_share
    assert outcome.result.content_mesh.vertices == pytest.approx(
        whole.content_mesh.vertices, abs=1e-9
    )
    page = (tmp_path / "out" / "report.html").read_text()
    assert 'id="growth"' in page
    assert (tmp_path / "out" / "figures" / "growth.png").is_file()


def test_frames_of_geraf_sens_are_planes_once_they_are_whole(capture, tmp_path):
    folder, few = tmp_path / "scan", replace(capture, poses=capture.poses[:3])
    whole = geraf2.reconstruct(few, examples.BOX_M, COARSE)
    _write_capture_json(folder, n_poses=3)
    first, *others = few.poses
    for sub, part in enumerate((slice(0, 200), slice(200, None))):  # of one plane
        write_frame(folder / f"mf/0_{first.angle_deg:g}_{sub}", first.select(part), dtype=float)
    for number, pose in enumerate(others, start=1):
        write_frame(folder / f"mf/{number}_{pose.angle_deg:g}_0", pose, dtype=float)
    signal = folder / f"mf/2_{few.poses[-1].angle_deg:g}_0" / "adci.npy"
    stored = signal.read_bytes()
    signal.write_bytes(stored[: len(stored) // 2])

    def finish():
        time.sleep(2.0)
        signal.write_bytes(stored)

    writer = threading.Thread(target=finish)
    writer.start()
    outcome, reports = _followed(folder, tmp_path / "out", LiveOptions(idle_s=60.0, report=False))
    writer.join()
    assert not any(report.is_left_out for report in reports)
    assert outcome.n_planes == 3
    assert outcome.result.content_mesh.vertices == pytest.approx(
        whole.content_mesh.vertices, abs=1e-6
    )
    imported = geraf2.import_capture("geraf-sens", folder, tmp_path / "imported")
    assert imported.sign.sign == -1
    stored, wanted = (
        geraf2.load_capture(path) for path in (tmp_path / "out/scene", tmp_path / "imported")
    )
    assert all(
        np.array_equal(a.signal, b.signal) for a, b in zip(stored.poses, wanted.poses, strict=True)
    )


def test_an_error_is_one_line_and_the_session_continues(capture, tmp_path):
    folder, poses = tmp_path / "scan", capture.poses
    _write_capture_json(folder)
    write_frame(folder / "mf/0_0_0", poses[0])
    write_frame(folder / "mf/1_60_0", poses[0])  # again, which a session refuses
    _write_half_a_frame(folder / "mf/3_180_0", poses[2])
    write_frame(folder / "mf/4_240_0", replace(poses[3], axes=2.0 * poses[3].axes))
    write_frame(folder / "mf/5_300_0", poses[4])
    _settle(folder)
    outcome, reports = _followed(folder, tmp_path / "out")
    assert outcome.n_planes == 2
    assert outcome.reason == "no plane came for 0.5 s"
    problems = [report.problem for report in reports if report.is_left_out]
    for text in (
        "is plane 0 again",
        "file of the frame is missing",
        "columns are not orthonormal",
    ):
        assert len([problem for problem in problems if text in problem]) == 1, text
    assert len(problems) == 3
    assert not any("\n" in problem for problem in problems)
