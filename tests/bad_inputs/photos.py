"""Photos of the box: cameras, masks and options."""

from bad_inputs.table import bad, cut, drop, put, swap, sweep, values

ROWS = [
    *(
        bad(f"los {name} out --preset quick", change, text=text)
        for name, change, text in (
            ("nerf", put("nerf/transforms.json", "{}"), "transforms.json"),
            ("nerf", values("nerf/transforms.json", fl_x=0), "focal"),
            ("nerf", values("nerf/transforms.json", fl_x="wide"), "fl_x"),
            ("nerf", values("nerf/transforms.json", w=-4), "transforms.json"),
            ("nerf", swap("nerf/transforms.json", "[[", "[[1e400,"), "transforms.json"),
            ("colmap", cut("colmap/sparse/0/images.bin"), "images.bin"),
            ("colmap", put("colmap/sparse/0/cameras.bin", b""), "cameras.bin"),
            ("colmap_text", put("colmap_text/sparse/0/images.txt", "1 2 3"), "images.txt"),
            ("colmap_text", swap("colmap_text/sparse/0/cameras.txt", "OPENCV", "X"), "cameras.txt"),
            ("colmap_text", swap("colmap_text/sparse/0/cameras.txt", "64", "-6"), "cameras.txt"),
            ("nerf", values("nerf/transforms.json", frames=[3]), "transforms.json"),
            ("nerf", values("nerf/transforms.json", frames=[{}]), "transforms.json"),
            ("nerf", values("nerf/transforms.json", camera_model="FISH"), "transforms.json"),
            ("nerf", values("nerf/transforms.json", cx="nan"), "cx"),
            ("nerf", values("nerf/transforms.json", k1=1e300), "nerf"),
            ("nerf", values("nerf/transforms.json", k4=0.1), "fisheye"),
            ("nerf", values("nerf/transforms.json", unit="inch"), "unknown unit"),
            ("nerf", put("nerf/transforms.json", b"\xff"), "transforms.json"),
            ("colmap", drop("colmap/images"), "images"),
            ("colmap_text", put("colmap_text/sparse/0/cameras.txt", "1 PINHOLE a b"), "cameras"),
            ("colmap_text", put("colmap_text/sparse/0/images.txt", ""), "no photo"),
        )
    ),
    *sweep("los nerf out {}", "hold-out -1 1\nmask-threshold -1 255 nan\nseed -1\nmasks nowhere"),
    bad("los nerf out --masks nerf --mask-threshold 20", text="both"),
]
