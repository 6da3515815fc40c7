"""
Bubble wrap
===========

400 weak scatterers around the object, with a tenth of its energy. Both presets accept a glint
only if neighbours agree with it. ``best`` also asks for a smooth surface that connects it to
strong glints. With twelve planes both cope. With 36 planes ``best`` has the higher score in the
mean of six objects (:doc:`results </results>`).
"""

# sphinx_gallery_thumbnail_path = "_static/gallery/plot_08_wrapping.png"

from pictures import BOX_M, scene, side_by_side

import geraf2
from geraf2.simulation import DisturbanceSpec, FigureSpec

spec = scene(
    FigureSpec(name="chicken", height_m=0.12),
    disturbance=DisturbanceSpec(scatterer_energy_fraction=0.1),
)
capture, truth = geraf2.simulate(spec, seed=0)
meshes = {}
for title, preset in (("fast", geraf2.FastPreset()), ("best", geraf2.BestPreset())):
    result = geraf2.reconstruct(capture, BOX_M, preset)
    f1 = geraf2.evaluate(result, truth, report=False).f1(0.005)
    meshes[f"{title}, F1 at 5 mm {f1:.2f}"] = result.content_mesh

side_by_side({**meshes, "true": truth})
