"""
A thin object, standing and lying
=================================

A key that stands shows its flat side to some plane, which reflects like a mirror. A key that lies
flat shows only its edge to all planes.
"""

# sphinx_gallery_thumbnail_path = "_static/gallery/plot_10_thin.png"

from pictures import BOX_M, scene, side_by_side

import geraf2
from geraf2.simulation import FigureSpec

for title, figure in (
    ("standing", FigureSpec(name="key", height_m=0.12)),
    ("lying", FigureSpec(name="key", height_m=0.0128, up="+x")),
):
    capture, truth = geraf2.simulate(scene(figure), seed=0)
    result = geraf2.reconstruct(capture, BOX_M)
    f1 = geraf2.evaluate(result, truth, report=False).f1(0.005)
    side_by_side({f"{title}, F1 at 5 mm {f1:.2f}": result.content_mesh, "true": truth})
