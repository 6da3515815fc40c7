"""Training of the paper's preset on a small capture, and that it resumes bit by bit."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from geraf2.errors import UserError
from geraf2.fields import BoxSolid, SdfGrid
from geraf2.io.checkpoint import load_checkpoint, save_checkpoint
from geraf2.learned.checkpoints import KIND, VERSION, config_of, load_model, load_state, save_state
from geraf2.learned.config import PaperConfig, StageConfig
from geraf2.learned.heatmaps import heat_maps
from geraf2.learned.model import PaperModel, domain_of
from geraf2.learned.optimiser import make_optimiser
from geraf2.learned.resources import training_device
from geraf2.learned.trainer import PaperTrainer, StepReport, run_steps, without_wall_pieces
from geraf2.ops import _tensors, matched_filter
from geraf2.scene import Grid, Wall
from helpers.carton import PRIOR

DEVICES = ["cpu", *(["cuda"] if torch.cuda.is_available() else [])]
SMALL = PaperConfig(
    device="cpu",
    n_cells=8,
    n_samples=10,
    n_antennas=16,
    window_m=0.0,
    n_looks=2,
    n_clusters=1,
    n_targets=64,
    grid_n=(9, 17),
    reflectivity_n=7,
    mesh_n=25,
    stage1=StageConfig(n_steps=6),
    stage2=StageConfig(n_steps=4, rsdf_weight=1.0, train_reflectivity=True),
)


@pytest.fixture(scope="module")
def maps(capture):
    return PaperTrainer(capture, PRIOR, SMALL).loss.maps


def parameters(trainer):
    return {name: p.detach().clone() for name, p in trainer.model.named_parameters()}


def test_both_stages_run_and_train_what_they_say(capture, maps):
    trainer = PaperTrainer(capture, PRIOR, SMALL, maps=maps)
    seen = [parameters(trainer)]
    reports = [trainer.advance() for _ in range(SMALL.stage1.n_steps)]
    seen.append(parameters(trainer))
    run_steps(trainer, on_step=reports.append)
    seen.append(parameters(trainer))
    assert trainer.stages.is_done
    assert [r.stage for r in reports] == [1] * 6 + [2] * 4
    assert all(r.rsdf == 0.0 for r in reports[:6])
    assert all(r.rsdf > 0.0 for r in reports[6:])
    assert seen[1]["sdf.values"].shape == (17, 17, 17)
    torch.testing.assert_close(
        seen[0]["reflectivity.logits"], seen[1]["reflectivity.logits"], rtol=0, atol=0
    )
    for name in ("sdf.values", "reflectivity.logits", "power.log_value"):
        assert (seen[1][name] != seen[2][name]).any(), name
    assert reports[0].inv_s == pytest.approx(SMALL.inv_s_start)
    assert reports[-1].inv_s == pytest.approx(SMALL.inv_s_end)


def test_training_lowers_the_heat_map_loss(capture, maps):
    """From four times the power that fits: single steps are speckle, the trend is not."""
    config = replace(SMALL, grid_n=(9,), stage1=StageConfig(n_steps=40), power_rate=0.05)
    trainer = PaperTrainer(capture, PRIOR, config, maps=maps)
    with torch.no_grad():
        trainer.model.power.log_value.add_(np.log(4.0))
    losses = [trainer.advance().heatmap for _ in range(40)]
    assert np.mean(losses[-15:]) < 0.8 * np.mean(losses[:3])


def test_a_resumed_training_of_networks_is_the_uninterrupted_one_bit_by_bit(
    capture, maps, tmp_path
):
    """That of grids is in tests/cli/test_paper_preset.py."""
    config = replace(SMALL, n_planes=2, field="mlp", mlp_fit_steps=1, n_cells=3, n_samples=4)
    config = replace(config, stage1=StageConfig(n_steps=1), stage2=StageConfig(n_steps=2))
    whole = PaperTrainer(capture, PRIOR, config, maps=maps)
    run_steps(whole)
    first = PaperTrainer(capture, PRIOR, config, maps=maps)
    run_steps(first, max_steps=2)
    save_checkpoint(tmp_path / "c.safetensors", save_state(first, "key"))
    second = PaperTrainer(capture, PRIOR, config, maps=maps, seed=9)  # the seed is in the state
    stored = load_checkpoint(tmp_path / "c.safetensors", kind=KIND, version=VERSION)
    load_state(second, stored, "key", "c")
    assert second.stages.steps_done == 2
    run_steps(second)
    for name, value in parameters(whole).items():
        assert torch.equal(value, parameters(second)[name]), name


def test_planes_side_by_side_train_what_one_after_the_other_does(capture, maps):
    config, before = replace(SMALL, n_planes=3), torch.get_num_threads()
    alone = PaperTrainer(capture, PRIOR, config, maps=maps, num_threads=1)
    beside = PaperTrainer(capture, PRIOR, config, maps=maps, num_threads=2)
    assert beside.threads.n_of_plane == 1
    for trainer in (alone, beside):
        run_steps(trainer)
    assert torch.get_num_threads() == before
    for name, value in parameters(alone).items():
        assert torch.equal(value, parameters(beside)[name]), name


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("form", [SMALL, replace(SMALL, field="mlp", mlp_fit_steps=1)])
def test_steps_without_the_kernels_are_those_with_them(capture, maps, monkeypatch, form, device):
    """On a GPU, and as on one: every op of both stages in torch alone.

    With Adam's own eps first steps are signs of gradients, those near zero of rounding; a larger
    one lets such gradients count for nothing, so that rounding stays rounding.
    """

    def steady_optimiser(*args):
        optimiser = make_optimiser(*args)
        for group in optimiser.param_groups:
            group["eps"] = 1e-4
        return optimiser

    monkeypatch.setattr("geraf2.learned.trainer.make_optimiser", steady_optimiser)
    stages = [replace(stage, n_steps=2) for stage in (form.stage1, form.stage2)]
    config = replace(form, stage1=stages[0], stage2=stages[1], n_planes=1)
    found = []
    for kernels in (True, False):
        monkeypatch.setattr(_tensors, "has_kernels", lambda *_, kernels=kernels: kernels)
        used = replace(config, device="cpu" if kernels else device)
        trainer = PaperTrainer(capture, PRIOR, used, maps=maps)
        reports = []
        run_steps(trainer, on_step=reports.append)
        found.append(np.array(reports))
    assert found[0].shape == (4, len(StepReport._fields))
    assert (found[0][2:, StepReport._fields.index("rsdf")] > 0.0).all()
    np.testing.assert_allclose(found[1][0], found[0][0], rtol=1e-5)
    assert np.ptp(found[0][:, StepReport._fields.index("eikonal")]) > 0.0  # the steps do something
    np.testing.assert_allclose(found[1], found[0], rtol=1e-3)


def test_a_missing_gpu_is_refused(monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    anything = replace(SMALL, device="auto")
    assert training_device(anything).type == "cpu"
    with pytest.raises(UserError, match="torch has no GPU"):
        training_device(replace(SMALL, device="cuda"))
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    assert training_device(anything).type == "cpu"  # kernels outrun a GPU on voxels
    assert training_device(replace(anything, field="mlp")).type == "cuda"
    assert training_device(replace(SMALL, device="cuda")).type == "cuda"
    assert training_device(replace(SMALL, device="cpu")).type == "cpu"


def test_a_checkpoint_of_other_settings_or_networks_is_one_line(capture, maps):
    trainer = PaperTrainer(capture, PRIOR, SMALL, maps=maps)
    state = save_state(trainer, "key")
    assert config_of(state.header, "c") == SMALL
    with pytest.raises(UserError, match="c: is a checkpoint of another scene or of other settings"):
        load_state(trainer, state, "other", "c")
    finer = PaperModel(domain_of(PRIOR, SMALL), replace(SMALL, reflectivity_n=9))
    with pytest.raises(UserError, match=r"other networks: reflectivity\.logits does not fit"):
        load_model(finer, state.arrays, "c")
    for name in ("model.more.weight", "other"):
        more = {**state.arrays, name: np.zeros(2, dtype=np.float32)}
        with pytest.raises(UserError, match=f"other networks: it has {name}"):
            load_model(trainer.model, more, "c")
    state.header["config"]["two_way"] = "thrice"
    state.header["config"]["no_such"] = 1
    with pytest.raises(UserError, match=r"c: settings: key 'two_way': .*; unknown key 'no_such'"):
        config_of(state.header, "c")


def test_octaves_open_evenly_over_stage_1_and_a_checkpoint_knows_how_many(capture, maps):
    config = replace(
        SMALL,
        field="mlp",
        mlp_fit_steps=1,
        octaves_start=2.0,
        octaves_end=6.0,
        stage1=StageConfig(n_steps=4),
        stage2=StageConfig(n_steps=1),
        n_planes=1,
        n_cells=3,
        n_samples=4,
        n_antennas=4,
    )
    trainer = PaperTrainer(capture, PRIOR, config, maps=maps)
    network = trainer.model.sdf
    seen = []
    while not trainer.stages.is_done:
        trainer.advance()
        seen.append(network.n_open.item())
    assert seen == pytest.approx([2.0, 3.0, 4.0, 5.0, 6.0])
    network.open_octaves(3.5)
    other = PaperModel(domain_of(PRIOR, config), config)
    load_model(other, save_state(trainer, "key").arrays, "c")
    grid = trainer.domain.grid(5)
    np.testing.assert_array_equal(
        other.sdf.sample_grid(grid).values, trainer.model.sdf.sample_grid(grid).values
    )


def test_a_plane_that_is_not_finite_is_named(capture):
    signal = capture.poses[2].signal.copy()
    signal[3, 4] = np.nan
    bad = replace(capture.poses[2], signal=signal)
    broken = replace(capture, poses=(*capture.poses[:2], bad, capture.poses[3]))
    with pytest.raises(
        UserError, match=r"plane 2 \(2\) has samples that are not finite.*got 1 NaN"
    ):
        PaperTrainer(broken, PRIOR, SMALL)


def test_echoes_are_delayed_by_the_walls_where_asked(capture, maps):
    walls = tuple(Wall(size_m=PRIOR.size_m, thickness_m=t, permittivity=2.25) for t in (2e-3, 3e-3))
    walled, signals = replace(PRIOR, walls=walls), []
    for wall_delay in (False, True):
        config = replace(SMALL, wall_delay=wall_delay)
        trainer = PaperTrainer(capture, walled, config, maps=maps)
        signal = trainer.loss.render(trainer.draws.draw(0)).signal / trainer.model.power()
        signals.append(signal.detach().numpy())
    turn = np.exp(-2j * np.pi * capture.waveform.frequencies_hz * 0.005 / 299792458.0)
    np.testing.assert_allclose(signals[1], signals[0] * turn, atol=1e-4 * abs(signals[0]).max())


CONTENT = replace(SMALL, region="content")


def test_a_training_of_the_content_samples_and_draws_in_the_crop_alone(capture):
    trainer = PaperTrainer(capture, PRIOR, CONTENT)
    inner = BoxSolid(size_m=PRIOR.crop(CONTENT.crop_m).size_m, center_m=PRIOR.center_m)
    scene = PaperTrainer(capture, PRIOR, SMALL)
    assert trainer.model.sdf.grid.spacing_m < 0.8 * scene.model.sdf.grid.spacing_m
    assert trainer.loss.maps.volumes.size < scene.loss.maps.volumes.size
    for plane in range(len(capture.poses)):
        draw = trainer.draws.draw(plane)
        assert inner.signed_distance(draw.rays.points.reshape(-1, 3).numpy()).max() < 1e-6
        # A target is moved by up to half a voxel of the maps from a point inside.
        reach_m = 0.5 * trainer.loss.maps.grid.spacing_m * 3**0.5
        assert inner.signed_distance(draw.targets.numpy()).max() < reach_m
    trainer.advance()


def test_pieces_that_lie_flat_at_the_crop_are_left_out_of_the_distance():
    grid = Grid.cube((0.0, 0.0, 0.0), 0.05, 51)
    points = grid.points()

    def ball(x, radius):
        return np.linalg.norm(points - np.array([x, 0.0, 0.0]), axis=1) - radius

    box = BoxSolid(size_m=(0.1, 0.1, 0.1)).signed_distance(points)
    crop_m, detail_m = 0.01, 0.006

    def field(*distances):
        values = np.min(distances, axis=0).astype(np.float32).reshape(grid.shape)
        return SdfGrid(grid=grid, values=values)

    outside = field(box)
    # Cut at 40 mm; the piece beside the content reaches to 36 or to 32 mm.
    content = ball(0.0, 0.02)
    flat = without_wall_pieces(field(content, ball(0.046, 0.01)), outside, crop_m, detail_m)
    assert (flat.values[content.reshape(grid.shape) > 1e-3] > 0.0).all()
    inner = content.reshape(grid.shape) < 0.0
    np.testing.assert_array_equal(flat.values[inner], field(content).values[inner])
    deep = field(content, ball(0.042, 0.01))
    kept = without_wall_pieces(deep, outside, crop_m, detail_m)
    np.testing.assert_array_equal(kept.values, deep.values)
    # What is connected with the content stays, however near the cut it lies.
    joined = field(content, ball(0.026, 0.018))
    kept = without_wall_pieces(joined, outside, crop_m, detail_m)
    np.testing.assert_array_equal(kept.values, joined.values)


def test_heat_maps_of_both_are_those_of_the_matched_filter(capture):
    """One image for each draw, powers added."""
    pose, antennas = capture.poses[0], np.arange(0, 40, 3)
    generator = torch.Generator().manual_seed(0)
    looks = torch.randn(3, 14, 32, generator=generator, dtype=torch.complex128).requires_grad_()
    pose = replace(pose, signal=pose.signal.astype(np.complex128))
    targets = np.random.default_rng(1).uniform(-0.05, 0.05, (21, 3))
    positions = pose.tx_positions[antennas], pose.rx_positions[antennas], targets
    maps_of = heat_maps(pose, capture.waveform, antennas, looks, targets, floor=1e-9)
    powers = [matched_filter(s, *positions, capture.waveform, method="exact") for s in looks]
    want = torch.sqrt(torch.stack(powers).abs().square().sum(dim=0) + 1e-18)
    torch.testing.assert_close(maps_of[0], want)
    measured = matched_filter(pose.signal[antennas], *positions, capture.waveform, method="exact")
    np.testing.assert_allclose(maps_of[1].numpy(), np.hypot(np.abs(measured), 1e-9))
    (slope,) = torch.autograd.grad(want.sum(), looks)
    (found,) = torch.autograd.grad(maps_of[0].sum(), looks)
    torch.testing.assert_close(found, slope)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"grid_n": (33, 17)}, "grid_n must be ascending numbers"),
        ({"octaves_start": 7.0, "octaves_end": 6.0}, "octaves_start must be at most octaves_end"),
        ({"region": "content", "start": "nested"}, 'start must be "ball", got nested'),
    ],
)
def test_settings_that_cannot_be_are_refused(settings, message):
    with pytest.raises(ValueError, match=message):
        PaperConfig(**settings)
