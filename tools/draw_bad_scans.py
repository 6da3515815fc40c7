"""Draw the pictures of docs/how-to/verdict.md: results of bad scans, with their verdicts as text.

python bench/python/verdict_scans.py --out SET --set estimate
python tools/draw_bad_scans.py SET [KIND...]
"""

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from PIL import Image

import geraf2
from geraf2.io.mesh import TriangleMesh, read_mesh
from geraf2.report.render import MeshPainter, View

FOLDER = Path(__file__).resolve().parent.parent / "docs" / "how-to"
SCANS = {
    "height": "height-cat",
    "sense": "sense-ordinary-cat-4-2",
    "axes": "axes-ordinary-stool-7-1",
    "swapped": "swapped-ordinary-man-0-1",
    "few-planes": "few-planes-ordinary-cat-4-0",
    "plastic": "plastic-ball-1",
    "saturated": "saturated-ordinary-cat-3-0",
    "hard": "hard-3300",
}
"""Scan of the set by the kind of its fault."""
AS_RECORDED = ("sense",)
"""Kinds whose picture shows the result without a correction that geraf2 makes by itself."""
RESULT, TRUTH = (0.93, 0.55, 0.30), (0.62, 0.66, 0.70)
N_PIXELS, SHOWN_PIXELS = 480, 240


def drawn(mesh: TriangleMesh, view: View, colour: tuple[float, float, float]) -> np.ndarray:
    """Picture on white, (N_PIXELS, N_PIXELS, 3), 0 to 1."""
    colours = np.tile(np.array(colour), (len(mesh.vertices), 1))
    picture = MeshPainter(mesh).render(view, colours)
    return picture[..., :3] * picture[..., 3:] + 1.0 - picture[..., 3:]


def draw(result: TriangleMesh, truth: TriangleMesh, path: Path) -> None:
    """Both at the same scale, in the frame of the capture, side by side."""
    both = np.concatenate([result.vertices, truth.vertices])
    low, high = both.min(axis=0), both.max(axis=0)
    x, y, z = (0.5 * (low + high)).tolist()
    half = 0.55 * float(np.linalg.norm(high - low))
    view = View(azimuth_deg=-55.0, center_m=(x, y, z), half_width_m=half, n_pixels=N_PIXELS)
    panels = [drawn(result, view, RESULT), drawn(truth, view, TRUTH)]
    picture = Image.fromarray(np.round(255.0 * np.hstack(panels)).astype(np.uint8))
    small = picture.resize((2 * SHOWN_PIXELS, SHOWN_PIXELS), Image.Resampling.LANCZOS)
    small.quantize(48).save(path, optimize=True)


def show(scene: Path, kind: str) -> None:
    """Reconstruct a scan, print its verdict and draw its result."""
    with TemporaryDirectory() as out:
        try:
            result = geraf2.reconstruct(scene, preset="fast", out=out)
            print(kind, *(f"    {name:7}  {text}" for name, text in result.verdict.lines), sep="\n")
            if kind in AS_RECORDED:
                as_it_is = geraf2.RunOptions(calibrate="no")
                result = geraf2.reconstruct(
                    scene, preset="fast", out=out, options=as_it_is, overwrite=True
                )
        except geraf2.UserError as error:
            print(kind, f"    error: {error}", sep="\n")
            return
        draw(result.content_mesh, read_mesh(scene / "truth.ply"), FOLDER / f"bad-{kind}.png")


def main() -> None:
    """Draw all kinds, or those that are named."""
    scans, *kinds = sys.argv[1:]
    for kind in kinds or SCANS:
        show(Path(scans) / SCANS[kind], kind)


if __name__ == "__main__":
    main()
