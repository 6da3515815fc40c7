"""Draw six pictures of a surface that grows with its scan, coloured by its expected error.

python tools/draw_live.py docs/how-to/live.png        # two minutes of one core
"""

import sys
from dataclasses import replace
from importlib.resources import as_file, files

import matplotlib as mpl

mpl.use("agg")
from matplotlib import pyplot as plt

import geraf2
from geraf2.io.mesh_colours import error_colours
from geraf2.report import MeshPainter, View
from geraf2.simulation import load_spec, simulate

N_PLANES, SHOWN = 12, (1, 2, 3, 4, 6, 12)
AZIMUTH_DEG, ELEVATION_DEG, HALF_WIDTH_M, HALF_HEIGHT_M = 128.0, 14.0, 0.075, 0.0909


def main() -> None:
    with as_file(files("geraf2.simulation") / "demo.toml") as path:
        spec = load_spec(path)
    scan = replace(spec.scan, n_poses=N_PLANES)
    capture, _ = simulate(replace(spec, scan=scan), seed=0)
    view = View(
        azimuth_deg=AZIMUTH_DEG,
        elevation_deg=ELEVATION_DEG,
        center_m=(0.0, 0.0, 0.0),
        half_width_m=0.1,
        n_pixels=360,
    )
    figure, panels = plt.subplots(1, len(SHOWN), figsize=(9.6, 2.3))
    step = 5  # no factor of 12: each plane lies far from the one before
    with geraf2.Session(replace(capture, poses=()), spec.walls[0].size_m) as session:
        for number in range(1, N_PLANES + 1):
            session.add(capture.poses[(number - 1) * step % N_PLANES])
            if number not in SHOWN:
                continue
            mesh, panel = session.result.content_mesh, panels[SHOWN.index(number)]
            colours = error_colours(mesh.expected_error_m, len(mesh.vertices)) / 255.0
            picture = MeshPainter(mesh).render(view, colours)
            panel.imshow(picture, extent=[-0.1, 0.1] * 2, interpolation="bilinear")
            error_mm = session.result.numbers["mesh"]["expected_error_median_mm"]
            planes = f"{number} plane{'s' * (number > 1)}"
            panel.set_title(f"{planes}, {error_mm:.1f} mm", fontsize=10)
            panel.set(xlim=(-HALF_WIDTH_M, HALF_WIDTH_M), ylim=(-HALF_HEIGHT_M, HALF_HEIGHT_M))
            panel.axis("off")
    figure.tight_layout(pad=0.3)
    figure.savefig(sys.argv[1], dpi=100, metadata={"Software": None})


if __name__ == "__main__":
    main()
