"""A scan in, a mesh out, in four lines.

geraf2 import geraf-sens CAPTURE scene
python examples/reconstruct.py scene 0.22 0.22 0.22
"""

import sys

import geraf2

capture = geraf2.load_capture(sys.argv[1])
prior = geraf2.LosPrior.from_box(tuple(map(float, sys.argv[2:5])))  # outside of the box [m]
result = geraf2.reconstruct(capture, prior)
result.content.export("content.ply")
print(f"{len(result.glints)} glints, {len(result.content.faces)} triangles, content.ply")
