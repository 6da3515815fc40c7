"""
A plastic object
================

Waves pass through plastic and echo at its far side, too: a second surface that appears too far
away. Glints behind others in the same line of sight are dropped where there are many. With twelve
planes parts of the true surface are lost with them.
"""

# sphinx_gallery_thumbnail_path = "_static/gallery/plot_07_plastic.png"

from pictures import BOX_M, scene, side_by_side

import geraf2
from geraf2.simulation import FigureSpec, WorldSpec

figure = FigureSpec(name="bunny", height_m=0.12)
meshes = {}
for title, world in (("metal", WorldSpec()), ("plastic", WorldSpec(figure_permittivity=2.8))):
    capture, truth = geraf2.simulate(scene(figure, world=world), seed=0)
    result = geraf2.reconstruct(capture, BOX_M)
    f1 = geraf2.evaluate(result, truth, report=False).f1(0.005)
    meshes[f"{title}, F1 at 5 mm {f1:.2f}"] = result.content_mesh

side_by_side({**meshes, "true": truth})
