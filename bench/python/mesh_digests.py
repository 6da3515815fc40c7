"""Digests of `mesh_content.ply` for fixed captures and presets: do two commits give the same bytes?

    python bench/python/mesh_digests.py [--data ../shared/data] [--presets fast best]

One line is printed for each capture and preset: blake2b of the file, its size, seconds. The
captures are that of `geraf2 demo`, an own simulation of another object, and, where --data is
given, the independent ones: spot_carton, and those of rough_world, whose box is found by radar.
Only the command line is used, as any two versions have it. Run it at both commits on one machine,
whose instruction set and library versions are part of the bytes, and compare the lines. The
comment of the file that names geraf2's own version is left out.
"""

import argparse
import hashlib
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from reconstruct import geraf2_command

OWN = """
[figure]
name = "dog"
height_m = 0.12
[[walls]]
size_m = [0.22, 0.22, 0.22]
thickness_m = 0.004
permittivity = 1.6
[scan]
n_poses = 16
spacing_m = 0.004
[disturbance]
snr_db = 20.0
"""


def run(*arguments: str) -> None:
    done = subprocess.run(
        [*geraf2_command(), *arguments], capture_output=True, text=True, check=False
    )
    if done.returncode != 0:
        sys.exit(f"geraf2 {' '.join(arguments)}: {done.stderr.strip()}")


def make_captures(folder: Path, data: Path | None) -> dict[str, tuple[Path, tuple[str, ...]]]:
    """Scene and prior flags of each capture."""
    (folder / "dog.toml").write_text(OWN, encoding="utf-8")
    run("demo", str(folder / "demo"))
    run("simulate", str(folder / "dog.toml"), str(folder / "dog"))
    captures = {
        "demo": (folder / "demo" / "scene", ("--los", str(folder / "demo/scene/los.ply"))),
        "dog": (folder / "dog", ("--los", str(folder / "dog/los.ply"))),
    }
    if data is not None:
        spot = data / "spot_carton"
        run("import", "geraf-sens", str(spot), str(folder / "spot"))
        captures["spot_carton"] = (folder / "spot", ("--los", str(spot / "los_box.ply")))
        for capture in sorted((data / "rough_world").iterdir()):
            run("import", "geraf-sens", str(capture), str(folder / capture.name))
            captures[capture.name] = (folder / capture.name, ())
    return captures


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--data", type=Path)
    parser.add_argument("--presets", nargs="+", default=["fast", "best"])
    parser.add_argument("--keep", type=Path, help="folder for scenes and runs")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder = arguments.keep or Path(scratch)
        folder.mkdir(parents=True, exist_ok=True)
        captures = make_captures(folder, arguments.data)
        for preset in arguments.presets:
            for name, (scene, prior) in captures.items():
                out, start = folder / f"{name}-{preset}", time.perf_counter()
                run("reconstruct", str(scene), str(out), *prior, "--preset", preset, "--no-report")
                lines = (out / "mesh_content.ply").read_bytes().split(b"\n")
                content = b"\n".join(x for x in lines if not x.startswith(b"comment geraf2 "))
                digest = hashlib.blake2b(content, digest_size=16).hexdigest()
                seconds = time.perf_counter() - start
                print(f"{name:<16} {preset:<8} {digest} {len(content)} {seconds:.0f} s", flush=True)


if __name__ == "__main__":
    main()
