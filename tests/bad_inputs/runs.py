"""Folders of runs: their record, settings and meshes."""

from bad_inputs.table import bad, cut, drop, flip, folder, keys, put, rows, swap, toml, values

ROWS = [
    bad("render run", values("run/run.json", version=99), text="99"),
    bad("render run", drop("run/config.toml")),
    bad("render run", put("run/config.toml", "preset = 'other'")),
    bad("render run", toml("run/config.toml", "fit.max_voxels", "-1"), text="max_voxels"),
    bad("render run", cut("run/prior.npz"), text="prior.npz"),
    *rows(
        "reconstruct scene out --config run/config.toml",
        put("run/config.toml", "preset = 3"),
        put("run/config.toml", ""),
        swap("run/config.toml", 'preset = "fast"', "preset = fast"),
    ),
    *rows(
        "evaluate run --truth truth.ply",
        cut("run/mesh_content.ply"),
        (cut("run/mesh_content.ply", 0.9), "content.ply"),
        (put("run/mesh_content.ply", "ply"), "content.ply"),
        drop("run/mesh_content.ply"),
        put("truth.ply", ""),
        folder("run/run.json"),
        (values("run/run.json", format="x"), "another"),
    ),
    bad("render run", flip("run/prior.npz", 70), text="prior.npz"),
    bad("render run", drop("run/prior.npz"), text="prior.npz"),
    bad("render run", put("run/config.toml", b"\xff"), text="config.toml"),
    *keys(
        "reconstruct scene out --config run/config.toml",
        "run/config.toml",
        """
        seed 1.5 "one"
        calibrate "maybe"
        box [1,2]|[nan,1,1]|"big"
        trust_los 1
        fit.spacing_m nan "fine"
        fit.unknown 1
        fit.cap_lean [0.2]|[2,3]
        glints.subaperture.max_cosine 1.0
        photos.mask_threshold 300
        """,
    ),
]
