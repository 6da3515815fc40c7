"""Photos of the box: cameras, masks and options."""

from bad_inputs.table import bad, cut, drop, flip, put, swap, sweep, values

TRANSFORMS, BINARY, TEXT = "nerf/transforms.json", "colmap/sparse/0/", "colmap_text/sparse/0/"
MIRROR = [[-1.0, 0, 0, 0], [0, 1.0, 0, 0], [0, 0, 1.0, 0], [0, 0, 0, 1.0]]


def of_all(**new):
    """The same keys of every frame; `{}` in a text is its number."""
    return [
        values(TRANSFORMS, "frames", n, **{key: _numbered(value, n) for key, value in new.items()})
        for n in range(5)
    ]


def _numbered(value, n):
    return value.format(n) if isinstance(value, str) else value


ROWS = [
    *(
        bad("los nerf out --preset quick", *changes, text=text)
        for text, *changes in (
            ("transforms.json", swap(TRANSFORMS, "[[", "[[1e400,")),
            ("transforms.json", values(TRANSFORMS, frames=[{}])),
            ("transforms.json", put(TRANSFORMS, b"\xff")),
            ("cx", values(TRANSFORMS, cx="nan")),
            ("nerf", values(TRANSFORMS, k1=1e300)),
            ("no list of frames", values(TRANSFORMS, frames=[])),
            ("is no object", values(TRANSFORMS, frames=[3])),
            ("focal lengths", values(TRANSFORMS, fl_x=0)),
            ("fl_x", values(TRANSFORMS, fl_x="wide")),
            ("w and h", values(TRANSFORMS, w=-4)),
            ("camera model", values(TRANSFORMS, camera_model="FISH")),
            ("fisheye", values(TRANSFORMS, k4=0.1)),
            ("unit", values(TRANSFORMS, unit="inch")),
            ("4 x 4", *of_all(transform_matrix=[[1.0]])),
            ("numbers", *of_all(transform_matrix="x")),
            ("file_path", *of_all(file_path=3)),
            ("mask_path", *of_all(mask_path=3)),
            ("5 photos", *of_all(file_path="{}" + "a" * 5000)),
            ("has a pose", *of_all(transform_matrix=...)),
            ("handedness", *of_all(transform_matrix=MIRROR)),
            ("share one file", *of_all(file_path="/somewhere/camera{}/photo0.png")),
        )
    ),
    *(
        bad(f"los {change.path.split('/')[0]} out --preset quick", change, text=text)
        for text, change in (
            ("images", drop("colmap/images")),
            ("images.bin", cut(BINARY + "images.bin")),
            ("cut off", put(BINARY + "cameras.bin", "")),
            ("model number", flip(BINARY + "cameras.bin", 12)),
            ("unknown camera model X", swap(TEXT + "cameras.txt", "OPENCV", "X")),
            ("camera parameters", swap(TEXT + "cameras.txt", " 64 ", " -6 ")),
            ("number of parameters", put(TEXT + "cameras.txt", "1 PINHOLE 64 48 1 2 3")),
            ("CAMERA_ID", put(TEXT + "cameras.txt", "1 PINHOLE a b")),
            ("cameras.txt: camera 42", put(TEXT + "cameras.txt", "1 PINHOLE 64 48 60 60 32 24")),
            ("IMAGE_ID", put(TEXT + "images.txt", "1 2 3")),
            ("images.txt: holds no photo", put(TEXT + "images.txt", "")),
        )
    ),
    *sweep("los nerf out {}", "mask-threshold|-1|256|nan\nmasks|nowhere"),
    bad("los nerf out", text="shows no silhouettes of the box"),
    bad("los nerf out --masks nerf --mask-threshold 20", text="both"),
    bad("los colmap/images out", text="run COLMAP"),
    bad("los none out", text="none"),
]
