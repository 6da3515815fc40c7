"""
How many planes?
================

The same figure from 4, 8 and 16 sides. A plane of 12 cm at 40 cm sees normals within 8.5 degrees of
its own direction: 16 planes nearly close the circle, 4 leave most of it to the smooth fill.
"""

from pictures import BOX_M, level_scan, scene, side_by_side

import geraf2
from geraf2.simulation import FigureSpec

meshes = {}
for n_planes in (4, 8, 16):
    spec = scene(FigureSpec(name="bunny", height_m=0.12), scan=level_scan(n_planes))
    capture, truth = geraf2.simulate(spec, seed=0)
    result = geraf2.reconstruct(capture, BOX_M)
    f1 = geraf2.evaluate(result, truth, report=False).f1(0.005)
    meshes[f"{n_planes} planes, F1 at 5 mm {f1:.2f}"] = result.content_mesh

side_by_side({**meshes, "true": truth})
