"""
A box in a box
==============

Each wall delays the waves. The known delay of both boxes is subtracted from every echo. Without
this correction the surface would lie a millimetre or two too far inside.
"""

# sphinx_gallery_thumbnail_path = "_static/gallery/plot_04_two_boxes.png"

from pictures import scene, side_by_side

import geraf2
from geraf2.simulation import FigureSpec

outer = geraf2.Wall(size_m=(0.22, 0.22, 0.22), thickness_m=0.004, permittivity=1.6)
inner = geraf2.Wall(size_m=(0.18, 0.18, 0.18), thickness_m=0.003, permittivity=1.6)
spec = scene(FigureSpec(name="jug", height_m=0.12), walls=(outer, inner))
capture, truth = geraf2.simulate(spec, seed=0)
result = geraf2.reconstruct(capture, outer.size_m)
bias = geraf2.evaluate(result, truth, report=False).surface_bias_m
print(f"median signed distance to the truth {1e3 * bias:+.2f} mm")

side_by_side({"reconstructed": result.content_mesh, "true": truth})
