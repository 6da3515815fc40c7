"""
An unknown delay
================

The recorded delay is wrong by 2 cm of path, 1 cm of range. Without calibration the whole surface
is displaced. ``reconstruct`` finds the delay from the echoes of the walls.
"""

# sphinx_gallery_thumbnail_path = "_static/gallery/plot_06_delay.png"

from dataclasses import replace

from pictures import BOX_M, scene, side_by_side

import geraf2
from geraf2.simulation import FigureSpec

capture, truth = geraf2.simulate(scene(FigureSpec(name="llama", height_m=0.12)), seed=0)
waveform = replace(capture.waveform, path_bias_m=capture.waveform.path_bias_m + 0.02)
wrong = replace(capture, waveform=waveform)
meshes = {}
for title, options in (
    ("as recorded", geraf2.RunOptions(calibrate="no", trust_los=True)),
    ("calibrated", geraf2.RunOptions()),
):
    result = geraf2.reconstruct(wrong, BOX_M, options=options)
    f1 = geraf2.evaluate(result, truth, report=False).f1(0.005)
    meshes[f"{title}, F1 at 5 mm {f1:.2f}"] = result.content_mesh

side_by_side({**meshes, "true": truth})
