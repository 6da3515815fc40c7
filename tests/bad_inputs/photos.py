"""Photos of the box: cameras, masks and options."""

from bad_inputs.table import bad, cut, drop, put, swap, sweep, values

ROWS = [
    *(
        bad(f"los {name} out --preset quick", change, text=text)
        for name, change, text in (
            ("nerf", swap("nerf/transforms.json", "[[", "[[1e400,"), "transforms.json"),
            ("colmap", cut("colmap/sparse/0/images.bin"), "images.bin"),
            ("nerf", values("nerf/transforms.json", frames=[{}]), "transforms.json"),
            ("nerf", values("nerf/transforms.json", cx="nan"), "cx"),
            ("nerf", values("nerf/transforms.json", k1=1e300), "nerf"),
            ("nerf", put("nerf/transforms.json", b"\xff"), "transforms.json"),
            ("colmap", drop("colmap/images"), "images"),
        )
    ),
    *sweep("los nerf out {}", "hold-out -1 1\nmask-threshold -1 255 nan\nseed -1\nmasks nowhere"),
    bad("los nerf out --masks nerf --mask-threshold 20", text="both"),
]
