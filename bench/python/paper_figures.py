"""Values of docs/paper-method.md: what the equations of the paper do to the zero level.

    python bench/python/paper_figures.py docs/paper-method.png

Prints each bias that it draws. Needs no capture.
"""

import argparse
from pathlib import Path

import matplotlib as mpl
import numpy as np

from geraf2.ops import matched_filter, ray_march
from geraf2.scene import Waveform

mpl.use("Agg")
from matplotlib import pyplot as plt  # the backend must be chosen first

INV_S = 84.0
STANDOFF_M = 0.36
RADIUS_M = 0.04
WAVEFORM = Waveform(
    start_frequency_hz=77.3704e9,
    chirp_slope_hz_per_s=70.15e12,
    sample_rate_hz=625e3,
    n_samples=32,
)
SPEED_OF_LIGHT_M_PER_S = 299792458.0


def weights(two_way: str) -> tuple[np.ndarray, np.ndarray]:
    """Weight against the signed distance along a ray that meets a plane head-on."""
    step = 2.5e-4
    sdf = np.arange(0.06, -0.06, -step)[None]
    ones = np.ones_like(sdf)
    out = ray_march(sdf, -ones, step * ones, INV_S, two_way=two_way)
    return sdf[0], np.asarray(out.weight)[0] / step


def interval_bias() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean position of the weight where it stands for mid-interval and for the near sample."""
    steps = np.linspace(0.5e-3, 10e-3, 20)
    middle, near = [], []
    for step in steps:
        positions = []
        for shift in np.linspace(0.0, 1.0, 16, endpoint=False):
            sdf = (0.08 - step * (np.arange(round(0.16 / step)) + shift))[None]
            ones = np.ones_like(sdf)
            weight = np.asarray(
                ray_march(sdf, -ones, step * ones, INV_S, two_way="unbiased").weight
            )
            positions.append((weight * sdf).sum() / weight.sum())
        middle.append(np.mean(positions))
        near.append(np.mean(positions) + 0.5 * step)
    return steps, np.array(middle), np.array(near)


def sphere_peaks() -> tuple[np.ndarray, np.ndarray]:
    """Depth of the brightest point behind the surface of a metal sphere, by side of aperture."""
    sides = np.linspace(0.02, 0.24, 12)
    depths = np.arange(-0.03, 0.05, 5e-4)
    # The antenna plane is x = 0, the sphere's near point lies at STANDOFF_M.
    center = np.array([STANDOFF_M + RADIUS_M, 0.0, 0.0])
    targets = np.zeros((depths.size, 3))
    targets[:, 0] = STANDOFF_M + depths
    peaks = []
    for side in sides:
        line = np.linspace(-0.5 * side, 0.5 * side, max(round(side / 0.004), 6))
        y, z = (a.ravel() for a in np.meshgrid(line, line))
        positions = np.stack([np.zeros_like(y), y, z], axis=1)
        path = 2.0 * (np.linalg.norm(positions - center, axis=1) - RADIUS_M)
        phase = 2.0 * np.pi / SPEED_OF_LIGHT_M_PER_S * path[:, None] * WAVEFORM.frequencies_hz
        image = matched_filter(np.exp(-1j * phase), positions, positions, targets, WAVEFORM)
        peaks.append(depths[int(np.abs(image).argmax())])
    return sides, np.array(peaks)


def spreading_shift() -> tuple[np.ndarray, np.ndarray]:
    """Where the peak of one echo lies if 1 / R^p is removed after the range blur, by p."""
    offsets = np.arange(-0.04, 0.04, 1e-4)
    blur = np.abs(np.sinc(offsets / WAVEFORM.range_cell_m))
    powers = np.arange(0, 5)
    return powers, np.array(
        [offsets[int((blur * (STANDOFF_M + offsets) ** p).argmax())] for p in powers]
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("out", type=Path)
    out = parser.parse_args().out
    figure, panels = plt.subplots(1, 4, figsize=(15, 3.4), layout="constrained")
    for two_way, label in (
        ("squared", "squared T, the paper"),
        ("unbiased", "T of both directions"),
    ):
        sdf, weight = weights(two_way)
        panels[0].plot(1e3 * sdf, weight / weight.max(), label=label)
        print(
            f"two-way weight, {two_way}: largest at f = {1e3 * sdf[int(weight.argmax())]:+.2f} mm"
        )
    print(f"  ln 2 / s = {1e3 * np.log(2) / INV_S:.2f} mm at s = {INV_S:g} per metre")
    panels[0].axvline(0.0, color="0.6", lw=0.8)
    panels[0].set(xlabel="signed distance [mm]", title="weight along a ray", xlim=(60, -40))
    panels[0].legend(fontsize=8)
    steps, middle, near = interval_bias()
    panels[1].plot(1e3 * steps, 1e3 * near, label="opacity at the near sample")
    panels[1].plot(1e3 * steps, 1e3 * middle, label="at mid-interval")
    panels[1].set(xlabel="step [mm]", ylabel="mean f of the weight [mm]", title="mid-interval")
    panels[1].legend(fontsize=8)
    at_4 = int(np.abs(steps - 4e-3).argmin())
    print(
        f"near sample at {1e3 * steps[at_4]:.1f} mm steps: {1e3 * near[at_4]:+.2f} mm in front, "
        f"mid-interval {1e3 * middle[at_4]:+.2f} mm"
    )
    sides, peaks = sphere_peaks()
    panels[2].plot(1e2 * sides, 1e3 * peaks, "o-")
    panels[2].set(
        xlabel="side of the aperture [cm]",
        ylabel="peak behind the surface [mm]",
        title=f"sphere of radius {1e3 * RADIUS_M:g} mm",
    )
    for side, peak in zip(sides, peaks, strict=True):
        print(f"caustic focusing, aperture {1e2 * side:4.1f} cm: peak {1e3 * peak:+.1f} mm behind")
    powers, shifts = spreading_shift()
    panels[3].plot(powers, 1e3 * shifts, "o-")
    panels[3].set(
        xlabel="power of R removed after the blur",
        ylabel="shift of the peak [mm]",
        title="spreading after the range blur",
    )
    for power, shift in zip(powers, shifts, strict=True):
        print(f"R^{power} after the range blur: {1e3 * shift:+.2f} mm")
    figure.savefig(out, dpi=90)


if __name__ == "__main__":
    main()
