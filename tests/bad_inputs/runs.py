"""Folders of runs: their record, settings and meshes."""

from bad_inputs.table import bad, cut, drop, flip, folder, keys, put, swap, toml, values

ROWS = [
    bad("render run", drop("run/run.json"), says="run"),
    bad("render run", put("run/run.json", "{")),
    bad("render run", put("run/run.json", "[]")),
    bad("render run", values("run/run.json", version=99), says="99"),
    bad("render run", values("run/run.json", stages=3)),
    bad("render run", drop("run/config.toml")),
    bad("render run", put("run/config.toml", "preset = 'other'")),
    bad("render run", toml("run/config.toml", "fit.max_voxels", "-1"), says="max_voxels"),
    bad("render run", cut("run/prior.npz"), says="prior.npz"),
    bad("evaluate run --truth truth.ply", cut("run/mesh_content.ply"), says="mesh_content.ply"),
    bad("evaluate run --truth truth.ply", drop("run/mesh_content.ply"), says="mesh_content.ply"),
    bad("evaluate run --truth truth.ply", put("run/run.json", b"\x00"), says="run.json"),
    bad("evaluate run --truth truth.ply", cut("truth.ply")),
    bad("evaluate run --truth truth.ply", put("truth.ply", "")),
    *(
        bad("reconstruct scene out --config run/config.toml", change)
        for change in (
            toml("run/config.toml", "fit.spacing_m", "nan"),
            toml("run/config.toml", "fit.spacing_m", "'4 mm'"),
            toml("run/config.toml", "fit.bending_weight", "-2.0"),
            toml("run/config.toml", "fit.unknown", "1"),
            toml("run/config.toml", "glints.least_probability", "2.0"),
            toml("run/config.toml", "glints.subaperture.step_m", "0.0"),
            put("run/config.toml", "preset = 3"),
            put("run/config.toml", ""),
            swap("run/config.toml", 'preset = "fast"', "preset = fast"),
        )
    ),
    *(
        bad("evaluate run --truth truth.ply", change)
        for change in (
            put("run/run.json", ""),
            put("run/run.json", "[" * 50000),
            values("run/run.json", scene="x"),
            values("run/run.json", stages=[]),
            folder("run/run.json"),
        )
    ),
    bad("evaluate run --truth truth.ply", values("run/run.json", format="x"), says="another"),
    bad("evaluate run --truth truth.ply", values("run/run.json", version="2"), says="another"),
    bad("evaluate run --truth truth.ply", cut("run/mesh_content.ply", 0.9), says="content.ply"),
    bad("evaluate run --truth truth.ply", put("run/mesh_content.ply", "ply"), says="content.ply"),
    bad("render run", flip("run/prior.npz", 70), says="prior.npz"),
    bad("render run", drop("run/prior.npz"), says="prior.npz"),
    bad("render run", put("run/config.toml", b"\xff"), says="config.toml"),
    *keys(
        "reconstruct scene out --config run/config.toml",
        "run/config.toml",
        """
        seed -1 1.5 "one"
        calibrate "maybe"
        box [1,2]|[nan,1,1]|"big"
        hold_out [nan]|3
        trust_los 1
        fit.cap_lean [0.2]|[2,3]
        fit.max_voxels 0 1.5
        glints.least_probability -1
        glints.subaperture.max_cosine 1.0 nan
        photos.mask_threshold 300 -1
        photos.preset "slow"
        photos.seed -2
        """,
    ),
]
