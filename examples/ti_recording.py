"""A recording as an AWR1843 with a DCA1000 makes it: the files of docs/tutorials/ti-board.md.

python examples/ti_recording.py FOLDER

Simulates a board with four receivers that moves over six planes around a carton of 16 cm. FOLDER
gets adc_data.bin, profile.cfg (chirp and frames), radar.toml (antennas and delay), scan.json
(planes and lines) and truth.ply.
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

import geraf2
from geraf2.io.mesh import write_mesh
from geraf2.io.scan_file import ScanFile, ScanLine, SweptArray, SweptPlane, write_scan_file

STANDOFF_M, COLUMN_M, ROW_M, HALF_M = 0.35, 0.004, 0.006, 0.06
N_PLANES, N_ROWS, N_COLUMNS, FRAME_S = 6, 21, 31, 0.04
TX_M = ((0.0, 0.0, 0.0),)
RX_M = ((0.0, -0.0108, 0.0), (0.0, -0.0088, 0.0), (0.0, -0.0069, 0.0), (0.0, -0.005, 0.0))
# 77 GHz and 70.15 MHz/us; 32 samples at 625 ksps from 5.28 us on, all receivers, complex.
PROFILE = """\
channelCfg 15 1 0
adcCfg 2 1
adcbufCfg -1 0 1 0 1
profileCfg 0 77 100 5.28 60 0 0 70.15 0 32 625 0 0 30
chirpCfg 0 0 0 0 0 0 0 1
frameCfg 0 0 1 0 40 1 0
"""


def plane(number: int) -> SweptPlane:
    """Rows of positions that look at the turntable's axis; a frame is recorded at each."""
    angle = 2.0 * np.pi * number / N_PLANES
    looking, across = -np.array([np.cos(angle), np.sin(angle)]), [np.sin(angle), -np.cos(angle)]
    ends = [(*(-STANDOFF_M * looking + y * np.array(across)),) for y in (-HALF_M, HALF_M)]
    lines = tuple(
        ScanLine(
            start_m=(*ends[0], float(z)),
            end_m=(*ends[1], float(z)),
            n_positions=N_COLUMNS,
            start_s=FRAME_S * N_COLUMNS * (N_ROWS * number + row),
            speed_m_per_s=COLUMN_M / FRAME_S,
        )
        for row, z in enumerate(np.linspace(-HALF_M, HALF_M, N_ROWS))
    )
    axes = ((*looking, 0.0), (*across, 0.0), (0.0, 0.0, 1.0))
    return SweptPlane(name=f"{number}", axes=axes, lines=lines, angle_deg=float(np.rad2deg(angle)))


def main(folder: Path) -> None:
    scan = ScanFile(
        planes=tuple(map(plane, range(N_PLANES))),
        array=SweptArray(tx_offsets_m=TX_M, rx_offsets_m=RX_M),
        spacing_m=COLUMN_M,
    )
    spec = geraf2.examples.small_scene()
    capture, truth = geraf2.simulate(replace(spec, scan=replace(spec.scan, sweeps=scan)), seed=0)
    # The board has the phase exp(+j 2 pi f t).
    signal = np.concatenate([pose.signal for pose in capture.poses]).conj()
    signal = np.round(signal * (8000.0 / np.abs(signal).max()))
    pairs = signal.reshape(len(signal), -1, 2)  # words: I I Q Q, receiver after receiver
    words = np.stack([pairs.real, pairs.imag], axis=2).astype("<i2")
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "adc_data.bin").write_bytes(words.tobytes())
    (folder / "profile.cfg").write_text(PROFILE)
    known = "path_bias_m = 0.15\n\n[raw]\nstart_time_s = 0.0\n\n[antennas]\n"
    antennas = f"tx_offsets_m = {[*map(list, TX_M)]}\nrx_offsets_m = {[*map(list, RX_M)]}\n"
    (folder / "radar.toml").write_text(known + antennas)
    write_scan_file(folder / "scan.json", scan)
    write_mesh(truth, folder / "truth.ply")
    print(f"{folder}: {words.nbytes / 1e6:.1f} MB, {len(signal) // len(RX_M)} frames")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
