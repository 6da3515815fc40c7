"""
An object in a carton
=====================

The scan of the package: an object 6 cm high, six planes, antennas 6 mm apart. It is coarse on
purpose and takes seconds on one core.
"""

# sphinx_gallery_thumbnail_path = "_static/gallery/plot_01_figure.png"

from pictures import side_by_side

import geraf2

capture, truth = geraf2.simulate(geraf2.examples.small_scene(), seed=0)
result = geraf2.reconstruct(capture, geraf2.examples.BOX_M)
scores = geraf2.evaluate(result, truth, report=False)
print(f"F1 at 15 mm {scores.f1(0.015):.2f}, at 5 mm {scores.f1(0.005):.2f}")

side_by_side({"reconstructed": result.content_mesh, "true": truth})
