"""
Noise
=====

At 0 dB the noise of each sample is as strong as all echoes together. Many antennas receive the
same glint, and their sum exceeds the noise by 30 dB.
"""

# sphinx_gallery_thumbnail_path = "_static/gallery/plot_05_noise.png"

from pictures import BOX_M, scene, side_by_side

import geraf2
from geraf2.simulation import DisturbanceSpec, FigureSpec

meshes = {}
for snr_db in (20.0, 0.0):
    spec = scene(FigureSpec(name="dog", height_m=0.12), disturbance=DisturbanceSpec(snr_db=snr_db))
    capture, truth = geraf2.simulate(spec, seed=0)
    result = geraf2.reconstruct(capture, BOX_M)
    f1 = geraf2.evaluate(result, truth, report=False).f1(0.005)
    meshes[f"{snr_db:.0f} dB, F1 at 5 mm {f1:.2f}"] = result.content_mesh

side_by_side({**meshes, "true": truth})
