"""Draw the pictures of docs/explanation/physics.md: each from the physics that it shows.

    python tools/draw_physics.py

All is flat (two coordinates), the radar that of the demo: 77.4 to 81 GHz, 0.4 m from the middle.
"""

from pathlib import Path

import matplotlib as mpl
import numpy as np

mpl.use("agg")
from matplotlib import pyplot as plt

FOLDER = Path(__file__).resolve().parent.parent / "docs" / "explanation"
SPEED_OF_LIGHT = 299_792_458.0
FREQUENCIES = 77.37e9 + 3.59e9 * np.linspace(0, 1, 24)  # [Hz]
DISTANCE = 0.4  # of the antennas from the body's middle [m]
RADIUS = 0.04  # of the body [m]
SEEN, UNSEEN, WAVE = "#1f77b4", "#c44e52", "#888888"


def line(width: float, spacing: float) -> np.ndarray:
    """Antennas on a line that looks along +x, (n, 2) [m]."""
    y = np.arange(-width / 2, width / 2 + spacing / 2, spacing)
    return np.stack([np.full_like(y, -DISTANCE), y], axis=1)


def ball_echo(antennas: np.ndarray) -> np.ndarray:
    """Echo of a smooth metal ball about the origin, (n_antennas, n_frequencies).

    Only the point whose normal meets the antenna echoes: the nearest one.
    """
    path = 2 * (np.linalg.norm(antennas, axis=1) - RADIUS)
    return np.exp(-2j * np.pi * np.outer(path, FREQUENCIES) / SPEED_OF_LIGHT)


def point_echo(antennas: np.ndarray, position: np.ndarray) -> np.ndarray:
    """Echo of a point, (n_antennas, n_frequencies)."""
    path = 2 * np.linalg.norm(antennas - position, axis=1)
    return np.exp(-2j * np.pi * np.outer(path, FREQUENCIES) / SPEED_OF_LIGHT)


def heat_map(signal: np.ndarray, antennas: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Magnitude of the matched filter at points (..., 2), largest 1."""
    image = np.zeros(points.shape[:-1], complex)
    step = FREQUENCIES[1] - FREQUENCIES[0]
    for antenna, samples in zip(antennas, signal, strict=True):
        path = 2 * np.linalg.norm(points - antenna, axis=-1)
        phasor = np.exp(2j * np.pi * FREQUENCIES[0] * path / SPEED_OF_LIGHT)
        turn = np.exp(2j * np.pi * step * path / SPEED_OF_LIGHT)
        for sample in samples:  # a recurrence over frequencies: one exponential less for each
            image += sample * phasor
            phasor = phasor * turn
    return np.abs(image) / np.abs(image).max()


def raster(half: float, n: int) -> np.ndarray:
    """Points of a square about the origin, (n, n, 2), first x."""
    axis = np.linspace(-half, half, n)
    return np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1)


def hann(antennas: np.ndarray, middle: float, width: float) -> np.ndarray:
    """Weight of each antenna of a sub-aperture, 0 outside, (n,)."""
    away = (antennas[:, 1] - middle) / width
    return np.where(np.abs(away) < 0.5, np.cos(np.pi * away) ** 2, 0.0)


def peak_of(weights: np.ndarray, antennas: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Brightest of the points in the image of the ball by weighted antennas, (2,) [m]."""
    used = weights > 0
    image = heat_map(ball_echo(antennas[used]) * weights[used, None], antennas[used], points)
    return points.reshape(-1, 2)[image.argmax()]


def draw_glint(axes: plt.Axes) -> None:
    turn = np.linspace(0, 2 * np.pi, 200)
    axes.fill(RADIUS * np.cos(turn), RADIUS * np.sin(turn), color="#dddddd", ec="black")
    antennas = line(0.25, 0.025)
    axes.plot(*antennas.T, "k|", ms=9)
    for antenna in antennas:
        normal = antenna / np.linalg.norm(antenna)
        axes.plot(*np.stack([antenna, RADIUS * normal]).T, color=SEEN, lw=0.7)
        axes.plot(*(RADIUS * normal), "o", color=SEEN, ms=3)
    slanted = RADIUS * np.array([np.cos(2.0), np.sin(2.0)])
    start, end = antennas[5], slanted
    normal = slanted / np.linalg.norm(slanted)
    incoming = (end - start) / np.linalg.norm(end - start)
    away = incoming - 2 * (incoming @ normal) * normal
    axes.plot(*np.stack([start, end, end + 0.09 * away]).T, color=UNSEEN, lw=1.0, ls="--")
    axes.text(-0.395, 0.14, "antennas", fontsize=8)
    axes.text(-0.1, 0.125, "reflected away", color=UNSEEN, fontsize=8)
    axes.text(-0.26, -0.125, "comes back: a glint", color=SEEN, fontsize=8)
    axes.set(aspect="equal", xlim=(-0.43, 0.08), ylim=(-0.15, 0.17))
    axes.axis("off")


def draw_aperture(both: tuple[plt.Axes, plt.Axes]) -> None:
    antennas, points = line(0.25, 0.0035), raster(0.07, 121)
    turn = np.linspace(0, 2 * np.pi, 200)
    middles = np.linspace(-0.08, 0.08, 9)
    whole = heat_map(ball_echo(antennas), antennas, points)
    small = sum(
        heat_map((ball_echo(antennas) * w[:, None])[w > 0], antennas[w > 0], points) ** 2
        for w in (hann(antennas, middle, 0.08) for middle in middles)
    )
    for axes, image, title in (
        (both[0], whole**2, "whole aperture, 25 cm"),
        (both[1], small / np.max(small), "sum of squares of 8 cm"),
    ):
        axes.imshow(image.T, origin="lower", extent=[-70, 70, -70, 70], cmap="magma")
        axes.plot(1e3 * RADIUS * np.cos(turn), 1e3 * RADIUS * np.sin(turn), "w--", lw=1)
        axes.set_title(title, fontsize=9)
        axes.set_xlabel("away from the radar (mm)", fontsize=8)
        axes.tick_params(labelsize=7)
    for middle in middles:
        peak = 1e3 * peak_of(hann(antennas, middle, 0.08), antennas, points)
        normal = np.array([-1e3 * DISTANCE, 1e3 * middle]) - peak
        ends = np.stack([peak, peak + 18 * normal / np.linalg.norm(normal)])
        both[1].plot(*ends.T, color="cyan", lw=1)
        both[1].plot(*peak, "o", color="cyan", ms=3)


def draw_height(axes: plt.Axes) -> None:
    axes.plot([-DISTANCE] * 2, [-0.125, 0.125], "k-", lw=3)
    axes.text(-0.415, 0.14, "antennas", fontsize=8)
    body = np.linspace(0, 2 * np.pi, 400)
    x, z = 0.035 * np.cos(body), 0.075 * np.sin(body)
    normal = np.stack([0.075 * np.cos(body), 0.035 * np.sin(body)])
    normal /= np.linalg.norm(normal, axis=0)
    # The normal, prolonged, meets the line of antennas on one side or the other.
    height = z + np.where(x < 0, -DISTANCE - x, DISTANCE - x) * normal[1] / normal[0]
    seen = np.abs(height) < 0.125
    axes.scatter(x, z, c=np.where(seen, SEEN, UNSEEN), s=5)
    for angle in np.linspace(np.pi - 0.6, np.pi + 0.6, 7):
        n = np.array([0.075 * np.cos(angle), 0.035 * np.sin(angle)])
        n /= np.linalg.norm(n)
        start = np.array([0.035 * np.cos(angle), 0.075 * np.sin(angle)])
        reach = (-DISTANCE - start[0]) / n[0]
        hits = abs(start[1] + reach * n[1]) < 0.125
        end = start + (reach if hits else 0.11) * n
        axes.plot(*np.stack([start, end]).T, color=SEEN if hits else UNSEEN, lw=0.8)
    axes.text(0.05, 0.07, "never seen", color=UNSEEN, fontsize=8)
    axes.text(0.05, 0.0, "seen", color=SEEN, fontsize=8)
    axes.set(aspect="equal", xlim=(-0.43, 0.14), ylim=(-0.16, 0.17))
    axes.axis("off")


def draw_spacing(both: tuple[plt.Axes, plt.Axes]) -> None:
    points = raster(0.11, 131)
    position = np.array([0.02, 0.06])
    for axes, spacing in zip(both, (0.003, 0.008), strict=True):
        antennas = line(0.25, spacing)
        image = heat_map(point_echo(antennas, position), antennas, points)
        axes.imshow(
            image.T, origin="lower", extent=[-110, 110, -110, 110], cmap="magma", vmin=0, vmax=1
        )
        axes.plot(*(1e3 * position), "o", mfc="none", mec="cyan", ms=12)
        axes.set_title(f"an antenna every {1e3 * spacing:.0f} mm", fontsize=9)
        axes.set_xlabel("away from the radar (mm)", fontsize=8)
        axes.tick_params(labelsize=7)


def main() -> None:
    for name, draw, n_axes, size in (
        ("glint", draw_glint, 1, (5.2, 3.2)),
        ("aperture", draw_aperture, 2, (6.6, 3.5)),
        ("height", draw_height, 1, (5.2, 3.2)),
        ("spacing", draw_spacing, 2, (6.6, 3.5)),
    ):
        figure, axes = plt.subplots(1, n_axes, figsize=size, layout="constrained")
        draw(axes)
        figure.savefig(FOLDER / f"{name}.png", dpi=110, metadata={"Software": None})
        plt.close(figure)


if __name__ == "__main__":
    main()
