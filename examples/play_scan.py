"""A stored scan, written into a folder plane by plane at the speed of an arm, for `geraf2 live`.

python examples/play_scan.py SCENE FOLDER [SECONDS A PLANE] &
geraf2 live FOLDER OUT
"""

import sys
import time
from dataclasses import replace
from pathlib import Path

from geraf2 import open_capture
from geraf2.io.growing_scene import GrowingScene
from geraf2.scene.store import manifest_of

if len(sys.argv) < 3:
    raise SystemExit(__doc__)
source, target = Path(sys.argv[1]), Path(sys.argv[2])
seconds = float(sys.argv[3]) if len(sys.argv) > 3 else 10.0

capture = open_capture(source)  # reads a plane at a time
provenance = {**capture.provenance, "n_planes": str(len(capture.poses))}
about = manifest_of(replace(capture, poses=(), provenance=provenance))
scene = GrowingScene(target, about)
for pose in capture.poses:
    time.sleep(seconds)
    scene.append(pose)
    print(f"plane {len(scene)} of {provenance['n_planes']}", flush=True)
