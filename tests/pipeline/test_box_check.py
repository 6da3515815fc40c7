"""A given prior against the box that the radar sees."""

from contextlib import nullcontext
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import geraf2
from geraf2 import examples, simulate
from geraf2.calibration.corrections import Corrections
from geraf2.calibration.found_box import FoundBox, Seen
from geraf2.errors import UserError
from geraf2.geometry.transforms import rigid
from geraf2.io.manifest import DELAY_KEY, DELAY_NOT_KNOWN
from geraf2.io.run_folder import CALIBRATION_NAME, RunFolder
from geraf2.pipeline import box_check
from geraf2.pipeline.box_check import check_prior
from geraf2.pipeline.commands import reconstruct as reconstruct_command
from geraf2.pipeline.events import Listener
from geraf2.scene import LosPrior
from geraf2.surfaces import FitConfig
from helpers.run_folders import add_steps

COARSE, FINER = (
    geraf2.FastPreset(fit=FitConfig(spacing_m=spacing_m)) for spacing_m in (0.01, 0.005)
)
SIZE = np.array([0.30, 0.20, 0.25])


def turn(degrees):
    return rigid(Rotation.from_euler("z", degrees, degrees=True).as_matrix(), np.zeros(3))


def a_box(seen=((2, 2), (2, 2), (0, 0)), degrees=0.0):
    seen = np.array(seen)
    return FoundBox(
        axes=turn(degrees)[:3, :3].T,
        turn_sigma_rad=np.full(3, 0.005),
        offsets_m=np.repeat(0.5 * SIZE[:, None], 2, axis=1),
        sigmas_m=np.where(seen == Seen.SQUARELY, 5e-4, np.inf),
        bounds_m=np.zeros((3, 2, 2)),
        seen=seen,
        content_share=0.3,
    )


def check(prior, found, monkeypatch):
    monkeypatch.setattr(box_check, "find_box", lambda *_, **__: found)
    capture = examples.small_capture()[0]
    return check_prior(capture, prior, "--box", None, Listener(), None)


def given(size=SIZE, center=(0.0, 0.0, 0.0), degrees=0.0):
    return LosPrior.from_box(tuple(size), center).move(turn(degrees))


@pytest.mark.parametrize(
    "prior",
    [
        given(),
        given(SIZE + 0.004),
        given(center=(0.005, 0.0, 0.03)),
        given(degrees=2.5),
        given(SIZE[[1, 0, 2]], degrees=88.0),  # axes are assigned by matching sides
    ],
)
def test_a_correct_prior_is_kept(prior, monkeypatch):
    assert check(prior, a_box(), monkeypatch).prior is prior


@pytest.mark.parametrize(
    ("prior", "stated", "off_m"),
    [
        (given(SIZE + 0.008), "off by 8.0 mm of size and was", 0.008),
        (given(SIZE - 0.008), "off by 8.0 mm of size and was", 0.008),
        (given(degrees=12.0), "off by 12.0 degrees of rotation and was", 0.0),
        (given(center=(0.02, 0.0, 0.0)), "off by 20.0 mm of position and was", 0.02),
    ],
)
def test_a_wrong_prior_gets_the_faces_that_were_seen(prior, stated, off_m, monkeypatch):
    checked = check(prior, a_box(), monkeypatch)
    assert stated in checked.text
    axes, size, center = checked.prior.cuboid
    np.testing.assert_allclose(axes, np.eye(3), atol=1e-9)
    np.testing.assert_allclose(size[:2], SIZE[:2])
    np.testing.assert_allclose(center, 0.0, atol=1e-9)
    # Its height was given, and is as uncertain as the sides are off.
    height = prior.cuboid[1][2]
    np.testing.assert_allclose(size[2], height + 2.0 * off_m)
    if off_m:
        np.testing.assert_allclose(np.ptp(checked.prior.certain[:, 2]), height - 2.0 * off_m)


@pytest.fixture(scope="module")
def in_free_air():
    """Content without a box, and the truth."""
    return simulate(replace(examples.small_scene(), walls=()), seed=0)


def test_a_prior_that_nothing_was_compared_with_is_a_line(in_free_air, tmp_path):
    heard = []
    listener = Listener()
    listener.note = heard.append
    capture, truth = in_free_air
    sides = tuple(float(s) for s in np.ptp(truth.vertices, axis=0) + 0.03)
    geraf2.reconstruct(capture, sides, COARSE, tmp_path / "run", listener=listener)
    line = "too few walls are seen squarely: the prior could not be checked, and is used as it is"
    assert line in heard


def test_a_face_seen_alone_keeps_the_given_size_as_uncertain_as_others(monkeypatch):
    found = a_box(seen=((0, 2), (2, 2), (0, 0)))
    checked = check(given((0.306, 0.212, 0.25), (0.0, 0.02, 0.0)), found, monkeypatch)
    _, size, center = checked.prior.cuboid
    np.testing.assert_allclose(size[:2], [SIZE[0] + 0.006 + 0.012, SIZE[1]])
    np.testing.assert_allclose(center[:2], [-0.003 - 0.006, 0.0], atol=1e-9)


def test_another_box_is_an_error_with_both_sizes(monkeypatch):
    text = r"box: the scan shows another box .* sides of 360 x 240 mm, got 300 x 200 mm .*trust_los"
    with pytest.raises(UserError, match=text):
        check(given(1.2 * SIZE), a_box(), monkeypatch)


def test_a_prior_of_another_shape_and_one_with_one_pair_of_planes_are_kept(monkeypatch):
    box = given(0.5 * SIZE)
    vertices = box.vertices * [1.0, 1.0, 1.3] + 0.1 * box.vertices[:, ::-1]
    corner = LosPrior(vertices=vertices, faces=box.faces)
    checked = check(corner, a_box(), monkeypatch)
    assert checked.prior is corner
    assert "no cuboid" in checked.text
    prior = given(1.2 * SIZE)
    checked = check(prior, a_box(seen=((0, 0), (2, 2), (0, 2))), monkeypatch)
    assert checked.prior is prior
    assert checked.is_warning
    assert "planes 200 mm apart are no walls of the prior, whose side is 240 mm" in checked.text


def test_flat_content_is_not_another_box(monkeypatch):
    solid = replace(a_box(), content_share=0.001)
    checked = check(given(1.5 * SIZE), solid, monkeypatch)
    assert checked.found is None
    assert checked.text == "planes of 300 x 200 mm within the prior are content"
    with pytest.raises(UserError, match="another box"):  # it does not fit into the prior
        check(given(0.7 * SIZE), solid, monkeypatch)


def test_echoes_that_contradict_a_box_by_radar_are_a_warning_and_a_given_one_an_error(
    monkeypatch, tmp_path
):
    def contradict(*_, **__):
        raise UserError(what="the box does not contain the scene")

    monkeypatch.setattr(reconstruct_command, "require_echoes_inside", contradict)
    capture = replace(examples.small_capture()[0], walls=())
    geraf2.reconstruct(capture, None, COARSE, tmp_path / "run")
    assert "does not contain the scene" in (tmp_path / "run" / "log.jsonl").read_text()
    with pytest.raises(UserError, match="does not contain the scene"):
        geraf2.reconstruct(capture, LosPrior.from_box(examples.BOX_M), COARSE)


def stated(size):
    capture = examples.small_capture()[0]
    wall = replace(capture.walls[0], size_m=tuple(size))
    return replace(capture, walls=(wall,))


def check_stated(capture, found, monkeypatch):
    monkeypatch.setattr(box_check, "find_box", lambda *_, **__: found)
    return check_prior(capture, *box_check.stated_box(capture), None, Listener(), None)


def test_a_box_that_the_scene_states_is_checked_like_a_given_one(monkeypatch):
    agreeing = check_stated(stated(SIZE + 0.003), a_box(), monkeypatch)
    assert agreeing.text.startswith("the box of the scene agrees: sides of 303 x 203 mm differ by")
    np.testing.assert_allclose(agreeing.prior.size_m, SIZE + 0.003)
    assert agreeing.name == box_check.STATED
    turned = check_stated(stated(SIZE), a_box(degrees=12.0), monkeypatch)
    assert "the box of the scene is off by 12.0 degrees of rotation and was" in turned.text


def test_a_box_that_the_scene_states_wrongly_is_replaced_with_a_warning(monkeypatch):
    checked = check_stated(stated(1.2 * SIZE), a_box(), monkeypatch)
    assert "the scene states sides of 360 x 240 mm, which the scan contradicts" in checked.text
    assert checked.is_warning
    assert checked.name == box_check.BY_RADAR
    np.testing.assert_allclose(checked.prior.size_m[:2], SIZE[:2])


def test_a_run_without_prior_uses_and_names_the_box_of_the_scene(tmp_path):
    run = geraf2.reconstruct(examples.small_capture()[0], None, COARSE, tmp_path / "run")
    box = run.numbers["box"]
    assert box["by_radar"].startswith("the box of the scene agrees: sides of 160 mm")
    assert box["delay_odds"] < 0.0 <= box["other_delay_m"]
    np.testing.assert_allclose(run.prior.size_m, examples.BOX_M)


def not_recorded(capture):
    provenance = {**capture.provenance, DELAY_KEY: DELAY_NOT_KNOWN}
    waveform = replace(capture.waveform, path_bias_m=0.0)
    return replace(capture, provenance=provenance, waveform=waveform, walls=())


def test_reconstruct_and_calibrate_find_the_same_delay_that_was_not_recorded(tmp_path):
    capture, _ = examples.small_capture()
    scene = tmp_path / "scene"
    geraf2.save_capture(not_recorded(capture), scene)
    prior = LosPrior.from_box(examples.BOX_M)
    run = geraf2.reconstruct(scene, prior, COARSE, tmp_path / "run")
    assert (
        "the delay was not recorded: with this box it is 152 mm" in run.numbers["box"]["by_radar"]
    )
    found_m = Corrections.load(tmp_path / "run" / CALIBRATION_NAME).delay_m
    assert found_m == pytest.approx(0.15, abs=0.004)
    assert geraf2.calibrate(scene, prior).table.path_bias_m == pytest.approx(found_m, abs=1e-3)


def test_content_in_free_air_is_reconstructed_with_a_warning_and_gives_no_delay(tmp_path):
    spec = replace(examples.small_scene(), walls=())
    spec = replace(spec, waveform=replace(spec.waveform, path_bias_m=0.0))
    capture, truth = simulate(spec, seed=0)
    run = geraf2.reconstruct(capture, None, FINER, tmp_path / "run")
    assert geraf2.evaluate(run, truth, n_samples=2000, report=False).f1(0.005) > 0.8
    assert not any("delay" in text for text in run.numbers["calibration"]["applied"])
    log = (tmp_path / "run" / "log.jsonl").read_text()
    assert "no walls of a box are seen" in log
    assert "give --box X Y Z" in log
    with pytest.raises(UserError, match="delay was not recorded, and the scan does not show it"):
        geraf2.reconstruct(not_recorded(capture), None, FINER)


def test_walls_of_a_turned_box_are_not_those_along_the_frame(monkeypatch):
    capture = examples.small_capture()[0]
    for degrees, n_walls in ((1.0, 1), (20.0, 0)):
        found = a_box(degrees=degrees)
        monkeypatch.setattr(box_check, "find_box", lambda *_, found=found, **__: found)
        box = box_check.box_from_radar(capture, None, Listener(), None)
        assert len(box.place(capture).walls) == n_walls
        np.testing.assert_allclose(box.prior.walls[0].size_m, SIZE)


@pytest.mark.parametrize(
    ("box", "error_mm", "is_refused"),
    [({}, 55.0, True), ({}, 5.0, False), ({"size_m": [0.2] * 3}, 55.0, False)],
)
def test_content_in_free_air_needs_a_certain_surface(tmp_path, box, error_mm, is_refused):
    run = RunFolder(tmp_path, "digest", "crate")
    mesh = {"expected_error_median_mm": error_mm}
    add_steps(run, {box_check.BOX_STAGE: {"by_radar": "none", **box}, "mesh": mesh})
    refused = pytest.raises(UserError, match="no certain surface")
    with refused if is_refused else nullcontext():
        box_check.require_determined(run)
