"""A simulated scene small enough to reconstruct in a test."""

# 9 planes of a 6 mm raster: simulates and reconstructs in seconds, and is
# still recognised as one body. Not a test of quality.
SPEC = """
[figure]
name = "llama"
height_m = 0.11
[[walls]]
size_m = [0.20, 0.20, 0.20]
[scan]
n_poses = 9
spacing_m = 0.006
aperture_m = [0.12, 0.14]
[numerics]
wall_patch_m = 0.02
antenna_block_m = 0.07
"""
_COARSE = {"fit.spacing-m": "0.012"}
FAST = ["--preset", "fast", *(w for name, v in _COARSE.items() for w in (f"--{name}", v))]
QUICK_BEST = [*(w for name, v in _COARSE.items() for w in (f"--refine.{name}", v))]
BOX = ["--box", "0.2", "0.2", "0.2"]
COARSE_RENDER = [
    *("--spacing-m", "0.02", "--echo.max-edge-m", "0.009", "--echo.wall-edge-m", "0.015"),
    *("--echo.n-planes", "2", "--echo.n-nodes", "3", "--echo.n-targets", "200"),
]
