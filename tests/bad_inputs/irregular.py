"""Files that are none: pipes, devices, files of holes, and links, wherever a file is read."""

from bad_inputs.lines import RAW, RUN, RX, SIGNAL
from bad_inputs.table import bad, holes, link, pipe, put, values

BOX = "--box 0.16 0.16 0.16"
EVALUATE = "evaluate run --truth truth.ply"
COARSE = "--every 4 --spacing-m 0.02"
GLTF = """{"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}],
"nodes": [{"mesh": 0}], "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "mode": 4}]}],
"accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
"bufferViews": [{"buffer": 0, "byteLength": 36}], "buffers": [{"uri": "%s", "byteLength": 36}]}"""
READ = """
info scene|scene/scene.toml
plan --like scene|scene/scene.toml
plan --like scan.json|scan.json
simulate spec.toml out|spec.toml
import geraf-sens frames out|frames/capture.json
import dca1000 raw/adc.bin out --radar radar.toml|radar.toml
import dca1000 raw/adc.bin out --radar radar.toml --positions robot.csv|robot.csv
info raw/adc.bin --radar radar.toml|radar.toml
verify run|run/run.json
inspect run|run/run.json
render run|run/config.toml
evaluate run --truth truth.ply|truth.ply.json
evaluate run --truth truth.ply|run/planes.json
evaluate run --truth truth.ply|run/mesh_content.ply.json
los colmap_text out|colmap_text/sparse/0/cameras.txt|no camera poses
los nerf out|nerf/transforms.json
los nerf out --unit m --to-radar to.txt|to.txt
batch scans.csv out|scans.csv
"""
"""Command lines that read a record or a table, and its name."""
STREAMED = """
verify run|run/prior.npz
verify run|run/mesh_content.ply
render run|run/sdf_fit.npz
los colmap out|colmap/sparse/0/images.bin|no camera poses
los box.ply out --unit m|box.ply
import geraf-sens frames out|frames/mf/1_120_0/adcr.npy
import mat scan.mat out|scan.mat
import mmnorm norm.npz out|norm.npz
import planar planar out|planar/scan.npy
import planar planar out|planar/antenna_phase.txt
info raw/adc.bin --radar radar.toml|raw/adc.bin
"""
"""Others, whose length has no limit of its own."""


def _rows(table, *changes):
    for entry in table.strip().splitlines():
        line, path, *text = entry.split("|")
        for change in changes:
            yield bad(line, change(path), text=text[0] if text and change != holes else None)


def zero(path):
    return link(path, "/dev/zero")


ROWS = [
    *_rows(READ, pipe),
    *_rows("\n".join(READ.split("\n")[1:4]), zero, holes),
    *_rows(STREAMED, pipe),
    *_rows("\n".join(STREAMED.split("\n")[1:4]), zero),
    *(
        bad(f"{line} --config {path}", pipe(path))
        for line, path in ((RAW, "studio.mmwave.json"), (RUN, "run/config.toml"))
    ),
    *(
        bad(line, change(f"scene/radar.zarr/{name}"))
        for line, changes in (
            ("info scene", (pipe, zero, holes)),
            ("verify scene", (pipe,)),
            (RUN, (pipe,)),
        )
        for name in ("zarr.json", "signal/zarr.json", "signal/c/1/0/0", "angle/c/0")
        for change in changes
    ),
    bad("los nerf out", *(pipe(f"nerf/images/photo{n}.png") for n in range(5)), text="photo"),
    bad("los nerf out", *(holes(f"nerf/images/photo{n}.png") for n in range(5)), text="none of"),
    *(
        bad("los a.gltf out --unit m", put("a.gltf", GLTF % name), *changes, text=text)
        for name, changes, text in (
            ("a.bin", (pipe("a.bin"),), "a.bin"),
            ("a.bin", (zero("a.bin"),), "outside"),
            ("a.bin", (put("a.bin", ""), holes("a.bin")), "a.bin"),
            ("../a.bin", (), "outside"),
            ("/dev/zero", (), "outside"),
        )
    ),
    # Links lead out of a folder that came from elsewhere.
    *(
        bad(line, link(path, target), text=f"{path}: is a link")
        for line, path, target in (
            ("info scene", f"{SIGNAL}/c/1/0/0", "../../../../c/0/0/0"),
            ("info scene", f"{RX}/c", "/etc"),
            ("verify scene", "scene/los.ply", "../box.ply"),
            (f"calibrate scene out {BOX}", "scene/photos/private.png", "/etc/passwd"),
            (f"calibrate scene out {BOX}", "scene/notes/private", "/etc/passwd"),
            ("verify run", "run/prior.npz", "../norm.npz"),
            (EVALUATE, "run/figures", "../other"),
            (EVALUATE, "run/metrics.json", "../other/diary.txt"),
            ("render run", "run/views", "../other"),
            ("los box.ply out --unit m", "out/training-1.safetensors", "../other/diary.txt"),
            ("inspect run", "run/inspection.json", "../other/diary.txt"),
            (f"image scene run --tiles --overwrite {COARSE}", "run/image.zarr", "../other"),
        )
    ),
    # A record may name any file below a link.
    *(
        bad(
            RUN.replace(" out ", " run ") + " --overwrite",
            link("run/notes", "../other"),
            values("run/run.json", **{key: named}),
            text="run/notes: is a link",
        )
        for key, named in (
            ("files", {"notes/diary.txt": ""}),
            ("scene", {"name": "x", "digest": "x"}),
        )
    ),
    *(
        bad(f"batch scene out {BOX}", put("out/batch.json", BATCH), change(path))
        for BATCH in ['{"format": "geraf2-batch", "version": 1, "jobs": {}}']
        for path in ("out/results", "out/results/x.json", "out/runs", "out/runs/scene-x")
        for change in (lambda path: link(path, "/etc"),)
    ),
]
