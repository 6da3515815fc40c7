"""A scan in, a mesh out, in ten lines.

geraf2 import geraf-sens CAPTURE scene
python examples/reconstruct.py scene 0.22 0.22 0.22
"""

import sys

from geraf2.glints import find_glints
from geraf2.io.mesh import write_mesh
from geraf2.scene import LosPrior, load_capture
from geraf2.surfaces import fit_sdf
from geraf2.surfaces.extraction import extract_meshes

capture = load_capture(sys.argv[1])
x, y, z = (float(side) for side in sys.argv[2:5])  # outside of the box [m]
prior = LosPrior.from_box((x, y, z), walls=capture.walls)
glints = find_glints(capture, prior)
sdf = fit_sdf(glints, capture, prior)
content = extract_meshes(sdf, glints, prior).mesh_content
write_mesh(content, "content.ply")
print(f"{len(glints)} glints, {len(content.faces)} triangles, content.ply")
