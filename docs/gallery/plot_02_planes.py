"""
How many planes?
================

The same object from 3, 6 and 12 sides. A plane of 14 cm at 40 cm sees normals within 10 degrees
of its own direction. Twelve planes see two thirds of the circle; of three, most of it is not
seen.
"""

# sphinx_gallery_thumbnail_path = "_static/gallery/plot_02_planes.png"

from pictures import BOX_M, level_scan, scene, side_by_side

import geraf2
from geraf2.simulation import FigureSpec

meshes = {}
for n_planes in (3, 6, 12):
    spec = scene(FigureSpec(name="bunny", height_m=0.12), scan=level_scan(n_planes))
    capture, truth = geraf2.simulate(spec, seed=0)
    result = geraf2.reconstruct(capture, BOX_M)
    f1 = geraf2.evaluate(result, truth, report=False).f1(0.005)
    meshes[f"{n_planes} planes, F1 at 5 mm {f1:.2f}"] = result.content_mesh

side_by_side({**meshes, "true": truth})
