"""Photos of the box: cameras, masks and options."""

from bad_inputs.table import bad, cut, drop, npy, npz, put, swap, sweep, values

NEUS = "neus/cameras_sphere.npz"
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
            ("neus", cut("neus/cameras_sphere.npz"), "cameras_sphere.npz"),
            ("neus", npz(NEUS, "NaN", world_mat_0=lambda a: a * float("nan")), "world_mat_0"),
            ("llff", npy("llff/poses_bounds.npy", "16 columns", lambda a: a[:, :16]), "bounds.npy"),
            ("llff", npy("llff/poses_bounds.npy", "NaN", lambda a: a * float("nan")), "bounds.npy"),
            ("ring", swap("ring/ring_par.txt", "6\n", "7\n"), "ring_par.txt"),
            ("ring", put("ring/ring_par.txt", "1\nphoto0.png 1 2"), "ring_par.txt"),
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
            ("neus", put("neus/cameras_sphere.npz", b""), "cameras_sphere"),
            ("neus", npz("neus/cameras_sphere.npz", "0", world_mat_0=lambda a: 0 * a), "world_mat"),
            ("neus", npz("neus/cameras_sphere.npz", "few", world_mat_1=None), "world_mat_1"),
            ("llff", npy("llff/poses_bounds.npy", "short", lambda a: a[:2]), "bounds"),
            ("llff", npy("llff/poses_bounds.npy", "pickled", lambda a: a.astype(object)), "bounds"),
            ("llff", put("llff/poses_bounds.npy", b"\x93NUMPY\x01\x00"), "bounds"),
            ("ring", put("ring/ring_par.txt", b"\xff\xff"), "ring_par"),
        )
    ),
    *sweep("los nerf out {}", "hold-out -1 1\nmask-threshold -1 255 nan\nseed -1\nmasks nowhere"),
    bad("los nerf out --masks nerf --mask-threshold 20", text="both"),
]
