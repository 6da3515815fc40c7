"""`geraf2 simulate`: a physical-optics capture, and photos of the box, from a spec."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from geraf2.cli._console import Positional, Threads, progress_bar, require_threads, say
from geraf2.cli._fields import Arg
from geraf2.io.atomic import atomic_folder
from geraf2.io.container import LOS_NAME, PHOTOS_NAME, TRUTH_NAME
from geraf2.io.mesh import TriangleMesh, write_mesh
from geraf2.scene import Capture, LosPrior
from geraf2.scene.photo_store import save_photos
from geraf2.scene.store import save_capture
from geraf2.simulation import SceneSpec, load_spec, simulate, simulate_photos


@dataclass(frozen=True, kw_only=True)
class Config:
    """Simulate the capture of a metal figure in boxes; writes a scene with its truth."""

    spec: Positional[Annotated[Path, Arg(metavar="SPEC.toml")]]
    """What to simulate."""
    out: Positional[Annotated[Path, Arg(metavar="OUT")]]
    """Scene folder to make; also gets truth.ply, los.ply and, if the spec asks, photos."""
    seed: int = 0
    """Seed of noise, jitter, scatterers and photos."""
    overwrite: bool = False
    """Replace another scene in this folder."""
    threads: Threads = None
    """Threads to use; all when not given."""


def main(config: Config) -> int:
    """Run the command."""
    num_threads = require_threads(config.threads)
    spec = load_spec(config.spec)
    simulate_scene(
        spec, config.out, seed=config.seed, overwrite=config.overwrite, num_threads=num_threads
    )
    say(f"scene   {config.out}")
    say(f"truth   {config.out / TRUTH_NAME}")
    if spec.walls:
        say(f"box     {config.out / LOS_NAME}")
    if spec.photos is not None:
        say(f"photos  {config.out / PHOTOS_NAME}")
    return 0


def simulate_scene(
    spec: SceneSpec, out: Path, *, seed: int, overwrite: bool, num_threads: int | None
) -> tuple[Capture, TriangleMesh]:
    """Simulate a capture and write it as a scene with truth.ply, los.ply and photos."""
    with progress_bar("simulating") as report:
        capture, truth = simulate(
            spec,
            seed=seed,
            num_threads=num_threads,
            progress=lambda done, n_planes: report(done / n_planes),
        )

    photos = None
    if spec.photos is not None:
        with progress_bar("photographing") as report:
            photos = simulate_photos(
                spec.photos,
                capture.walls,
                seed=seed,
                content=truth,
                num_threads=num_threads,
                progress=lambda done, n_photos: report(done / n_photos),
            )

    def write_extras(folder: Path) -> None:
        write_mesh(truth, folder / TRUTH_NAME, frame=capture.frame)
        if capture.walls:
            wall = capture.walls[0]
            prior = LosPrior.from_box(wall.size_m, wall.center_m)
            box = TriangleMesh(vertices=prior.vertices, faces=prior.faces)
            write_mesh(box, folder / LOS_NAME, frame=capture.frame)
        if photos is not None:
            save_photos(photos, folder / PHOTOS_NAME)

    written = save_capture(capture, out, overwrite=overwrite, extras=write_extras)
    if photos is not None and not written:  # the same capture was there, maybe without photos
        with atomic_folder(out / PHOTOS_NAME) as folder:
            save_photos(photos, folder)
    return capture, truth
