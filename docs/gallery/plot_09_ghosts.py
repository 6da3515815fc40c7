"""
Grating lobes of a coarse raster
================================

The heat map of one plane, antennas 3 mm and 9 mm apart. The coarse raster shows echoes between
the walls of the box where nothing is. ``geraf2 info`` prints the spacing that a scene needs.
"""

# sphinx_gallery_thumbnail_path = "_static/gallery/plot_09_ghosts.png"

import numpy as np
from matplotlib import pyplot as plt
from pictures import scene

import geraf2
from geraf2.simulation import FigureSpec, ScanSpec

grid = geraf2.Grid.cube((0.0, 0.0, 0.0), half_side_m=0.1, n_per_side=61)
figure, panels = plt.subplots(1, 2, figsize=(7.5, 3.8))
for panel, spacing_m in zip(panels, (0.003, 0.009), strict=True):
    scan = ScanSpec(n_poses=1, spacing_m=spacing_m, aperture_m=(0.12, 0.12))
    capture, truth = geraf2.simulate(
        scene(FigureSpec(name="ball", height_m=0.06), scan=scan), seed=0
    )
    image = geraf2.image_volume(capture, grid).max(axis=2)
    shown = 20 * np.log10(image / image.max())
    panel.imshow(shown.T, origin="lower", extent=[-100, 100, -100, 100], vmin=-25, cmap="magma")
    panel.set(title=f"{1e3 * spacing_m:.0f} mm apart, from above", xlabel="x (mm)")
figure.tight_layout()
