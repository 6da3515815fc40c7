"""Transmitters that send together are separated by their codes, or refused."""

import numpy as np
import pytest

from geraf2.apps.importers import ImportOptions, load_importer
from geraf2.apps.importers._ti_config import read_ti_configs
from geraf2.cli.main import main
from geraf2.errors import UserError
from geraf2.io.manifest import AntennaManifest, RadarManifest, RawManifest
from helpers.raw_capture import PROFILE, RADAR, quantised, whole_pose, words_of

# Chirps by their masks, and those whose second transmitter is turned.
TOGETHER = {
    "two, then a third": ([5, 5, 2], {1: 4}, [0, 2, 1]),
    "a third, then two": ([2, 5, 5], {2: 4}, [1, 0, 2]),
    "two": ([3, 3], {1: 2}, [0, 1]),
}


def signals(n_tx, n_loops=20, n_rx=4, n_samples=64):
    """Echoes of each transmitter, (n_loops, n_tx, n_rx, n_samples)."""
    rng = np.random.default_rng(n_tx)
    t = np.arange(n_samples) / n_samples
    phases = rng.uniform(0, 2 * np.pi, (1, n_tx, n_rx, 1))
    waves = np.exp(1j * (2 * np.pi * 5.3 * t + phases))
    return np.repeat(600 * waves, n_loops, axis=0)


def recorded(folder, masks, turned, order):
    """Recording of chirps with these masks, and the signals of the transmitters."""
    alone = signals(len(order))
    chirps = [
        sum(
            (-1 if turned.get(k, 0) >> tx & 1 else 1) * alone[:, order.index(tx)]
            for tx in range(3)
            if mask >> tx & 1
        )
        for k, mask in enumerate(masks)
    ]
    both = quantised(np.stack(chirps, axis=1)).reshape(-1, *alone.shape[2:])
    (folder / "a.bin").write_bytes(words_of(both).tobytes())
    return alone


def profile(folder, masks, turned):
    head = PROFILE.split("chirpCfg")[0]
    lines = [f"chirpCfg {k} {k} 0 0 0 0 0 {mask}" for k, mask in enumerate(masks)]
    lines.append(f"frameCfg 0 {len(masks) - 1} 20 1 50 1 0")
    lines += [f"bpmCfg -1 1 {k - 1} {k}" for k in turned]
    (folder / "a.cfg").write_text(head + "\n".join(lines) + "\n")
    return folder / "a.cfg"


def script(folder, masks, turned):
    def bits(mask, n=3):
        return ", ".join(str(mask >> k & 1) for k in range(n))

    lines = ["ar1.ProfileConfig(0, 77, 7, 6, 60, 0, 0, 0, 0, 0, 0, 60, 0, 64, 1000, 0, 0, 30)"]
    lines += [f"ar1.ChirpConfig({k}, {k}, 0, 0, 0, 0, 0, {bits(m)})" for k, m in enumerate(masks)]
    for k, mask in turned.items():
        on = ", ".join(f"0, {mask >> tx & 1}" for tx in range(3))
        lines.append(f"ar1.BpmChirpConfig({k}, {k}, {on})")
    lines.append(f"ar1.FrameConfig(0, {len(masks) - 1}, 1, 20, 50, 0, 0)")
    (folder / "a.lua").write_text("\n".join(lines))
    return folder / "a.lua"


def scan(folder, config, n_positions, **raw):
    antennas = AntennaManifest(
        tx_offsets_m=[[0.0, 0.002 * k, 0.0] for k in range(n_positions)],
        rx_offsets_m=[[0.0, -0.005 - 0.002 * k, 0.0] for k in range(4)],
    )
    radar = RadarManifest(**RADAR, antennas=antennas, raw=RawManifest(**raw))
    options = ImportOptions(config=(config,), static=True)
    return load_importer("dca1000").open(folder / "a.bin", radar, options)


@pytest.mark.parametrize("write", [profile, script])
@pytest.mark.parametrize("name", TOGETHER)
def test_two_that_send_together_are_separated(tmp_path, write, name):
    masks, turned, order = TOGETHER[name]
    alone = recorded(tmp_path, masks, turned, order)
    config = write(tmp_path, masks, turned)
    assert list(read_ti_configs([config]).transmitters.together) == order
    signal, tx, _ = whole_pose(scan(tmp_path, config, len(order)))
    assert np.abs(signal.reshape(alone.shape[1:]) - alone[0]).max() < 1.0
    assert np.allclose(tx[::4, 1], 0.002 * np.arange(len(order)))


@pytest.mark.parametrize(
    ("write", "masks", "turned"),
    [(profile, [3], {}), (profile, [3, 3], {}), (script, [7, 7], {1: 2}), (profile, [3, 4], {})],
)
def test_what_cannot_be_separated_is_refused_and_named(tmp_path, capsys, write, masks, turned):
    recorded(tmp_path, masks, turned, [0, 1, 2])
    config = write(tmp_path, masks, turned)
    with pytest.raises(UserError, match=f"send together .*masks? {masks[0]}"):
        scan(tmp_path, config, 3)
    assert main(["info", str(tmp_path / "a.bin"), "--config", str(config)]) == 0
    shown = capsys.readouterr().out
    assert f"{masks[0]}" in shown
    assert "no code separates them" in shown


def test_a_chirp_without_transmitter_is_refused(tmp_path):
    with pytest.raises(UserError, match="chirp 1 has no transmitter"):
        read_ti_configs([profile(tmp_path, [1, 0], {})])


@pytest.mark.parametrize("n_tx", [1, 2])
@pytest.mark.parametrize("bias", [0.0, 0.075])
def test_factors_of_the_profile_correct_the_channels(tmp_path, n_tx, bias):
    """Receivers that are mounted turned by 180 degrees, and any other phase."""
    rng = np.random.default_rng(4)
    gains = np.where(rng.random(12) < 0.5, -1, 1) * np.exp(1j * np.repeat([0, 0.4, 0.9], 4))
    masks = [1, 2][:n_tx]
    recorded(tmp_path, masks, {}, list(range(n_tx)))
    used = gains[: 4 * n_tx].reshape(n_tx, 4)
    plain = profile(tmp_path, masks, {})
    reference, *_ = whole_pose(scan(tmp_path, plain, n_tx))
    pairs = " ".join(f"{g.real:.6f} {g.imag:.6f}" for g in gains)
    plain.write_text(f"{plain.read_text()}\ncompRangeBiasAndRxChanPhase {bias} {pairs}\n")
    found = scan(tmp_path, plain, n_tx)
    signal, *_ = whole_pose(found)
    expected = reference.reshape(n_tx, 4, -1) * used[..., None]
    assert np.abs(signal.reshape(expected.shape) - expected).max() < 0.01
    assert "compensation" in dict(found.facts)
    assert found.manifest.waveform.path_bias_m == RADAR["path_bias_m"]  # what is given goes first
    assert (read_ti_configs([plain]).path_bias_m or 0.0) == 2 * bias


@pytest.mark.parametrize("line", ["0.0 1 0 1 0 1 0 1 0", "0 " + "1 0 " * 12])
def test_factors_of_one_change_nothing(tmp_path, line):
    recorded(tmp_path, [1], {}, [0])
    plain = profile(tmp_path, [1], {})
    plain.write_text(f"{plain.read_text()}\ncompRangeBiasAndRxChanPhase {line}\n")
    found = scan(tmp_path, plain, 1)
    assert "compensation" not in dict(found.facts)
    assert read_ti_configs([plain]).path_bias_m is None


@pytest.mark.parametrize("line", ["0.0 1 0 1 0", "0.0 1 0 1 0 1 0 0 0", "0.0 1 0 1"])
def test_factors_that_are_missing_are_named(tmp_path, line):
    recorded(tmp_path, [1], {}, [0])
    plain = profile(tmp_path, [1], {})
    line = line.replace("1 0", "0 1", 1)
    plain.write_text(f"{plain.read_text()}\ncompRangeBiasAndRxChanPhase {line}\n")
    with pytest.raises(UserError, match="compRangeBiasAndRxChanPhase"):
        scan(tmp_path, plain, 1)
