"""
Planes from above
=================

A horizontal scan sees no normal that points up. A ring of planes at 35 degrees sees as many
normals again: the back of the object is measured.
"""

# sphinx_gallery_thumbnail_path = "_static/gallery/plot_03_from_above.png"

from dataclasses import replace

from pictures import BOX_M, level_scan, scene, side_by_side

import geraf2
from geraf2.simulation import FigureSpec
from geraf2.simulation.spec import RingSpec

figure = FigureSpec(name="elephant", height_m=0.12)
level = level_scan(12)
meshes = {}
for title, scan in (
    ("one ring", level),
    ("two rings", replace(level, rings=(RingSpec(n_poses=12, elevation_deg=35.0),))),
):
    capture, truth = geraf2.simulate(scene(figure, scan=scan), seed=0)
    result = geraf2.reconstruct(capture, BOX_M)
    f1 = geraf2.evaluate(result, truth, report=False).f1(0.005)
    meshes[f"{title}, F1 at 5 mm {f1:.2f}"] = result.content_mesh

side_by_side({**meshes, "true": truth})
