"""Surface from photos: time, error against the truth, held-out views.

    python bench/python/photos.py carton [--seed 0] [--preset quick]
    python bench/python/photos.py PHOTOS [--mask-threshold 60] [--box X Y Z] [--bounds X0 .. Z1]

`carton` photographs a simulated carton of 0.22 m (48 photos of 640 x 480, with the simulator's pose
errors and noise); PHOTOS is any set that geraf2 reads, or one of Middlebury's, such as
`../shared/data/temple_photos`. --box are the true sides of a carton about
the origin, with which the mesh is compared: distances of points spread evenly over it, for the
faces that photos show and for the bottom that they do not. --bounds are published ones that the
mesh is compared with. The training knows neither. Every eighth photo is held out. PSNR is over
the pixels of the silhouette ("object") and over the whole picture with the background black in both
("picture"); IoU is of opacity above 1/2 with the silhouette, and for --mask-threshold with what is
brighter than that, shadows of the object left open ("unfilled"), too.
"""

import argparse
import json
import os
import resource
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import get_args

import numpy as np
import torch

from geraf2.apps.photos.formats.masks import threshold_mask
from geraf2.apps.photos.los import photo_config
from geraf2.apps.photos.photo_store import load_photos
from geraf2.apps.photos.training import train_neural_surface
from geraf2.evaluation.mesh_metrics import sample_surface
from geraf2.fields import BoxSolid
from geraf2.geometry.triangles import face_areas
from geraf2.io.mesh import write_mesh
from geraf2.pipeline.los_options import LosOptions, PhotoPreset
from geraf2.scene import Wall
from geraf2.surfaces.isosurface import largest_components, surface_report

sys.path.insert(0, str(Path(__file__).parents[1] / "photos"))
sys.path.insert(0, str(Path(__file__).parents[2] / "tests"))
from carton_photos import PhotosSpec, simulate_photos
from helpers.middlebury import convert_middlebury
from photo_writing import write_image

SIDE_M = 0.22
HOLD_OUT = 8
N_POINTS = 50_000
MIB = 1024


def psnr(difference):
    return float(-10.0 * np.log10(np.mean(difference**2)))


def overlap(first, second):
    return float((first & second).sum() / (first | second).sum())


def score_views(surface, photos, names, threshold):
    """Scores of held-out photos, and pictures: photo, rendered view, normals."""
    scores, pictures = {}, []
    for index, name in enumerate(names):
        view, photo = surface.render(photos.cameras[index]), photos.images[index] / 255.0
        mask = photos.masks[index]
        alone = photo * mask[..., None]
        solid = view.opacity > 0.5
        scores[name] = {
            "psnr_object_db": psnr((view.colour - photo)[mask]),
            "psnr_picture_db": psnr(view.colour - alone),
            "iou": overlap(solid, mask),
        }
        if threshold is not None:
            unfilled = threshold_mask(photos.images[index], threshold, fill_shadows=False)
            scores[name]["iou_unfilled"] = overlap(solid, unfilled)
        normals = (0.5 + 0.5 * view.normal) * view.opacity[..., None]
        pictures.append(np.concatenate([alone, view.colour, normals], axis=1))
    stacked = np.clip(np.concatenate(pictures), 0.0, 1.0)
    return scores, np.round(255.0 * stacked).astype(np.uint8)


def mean_scores(scores):
    keys = next(iter(scores.values()))
    return {key: float(np.mean([s[key] for s in scores.values()])) for key in keys}


def box_errors(mesh, size_m):
    """Distance of the mesh from the true outside, by face [mm]."""
    points = sample_surface(mesh, N_POINTS, np.random.default_rng(0))
    distance = 1e3 * BoxSolid(size_m=size_m).signed_distance(points)
    axis = np.argmax(np.abs(points) - 0.5 * np.asarray(size_m), axis=1)
    bottom = (axis == 2) & (points[:, 2] < 0.0)
    parts = {"seen": ~bottom, "top": (axis == 2) & ~bottom, "sides": axis < 2, "bottom": bottom}
    return {
        name: {
            "median_mm": float(np.median(np.abs(distance[part]))),
            "p95_mm": float(np.percentile(np.abs(distance[part]), 95)),
            "largest_mm": float(np.abs(distance[part]).max()),
            "mean_signed_mm": float(distance[part].mean()),
        }
        for name, part in parts.items()
    }


def largest_share(mesh):
    """Area of the largest component over that of all."""
    largest = largest_components(mesh, min_area_fraction=1.0)
    return float(face_areas(largest.corners).sum() / face_areas(mesh.corners).sum())


def mesh_facts(mesh, bounds):
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    report = surface_report(mesh)
    facts = {
        "low_m": low.tolist(),
        "high_m": high.tolist(),
        "n_faces": int(mesh.faces.shape[0]),
        "n_components": report.n_components,
        "is_watertight": report.is_watertight,
        "largest_component_share": largest_share(mesh),
    }
    if bounds is not None:
        beyond = np.stack([np.subtract(bounds[:3], low), np.subtract(high, bounds[3:])])
        facts["beyond_bounds_mm"] = float(1e3 * beyond.max())
    return facts


def read(options):
    if options.source == "carton":
        wall = Wall(size_m=(SIDE_M,) * 3, thickness_m=0.004, permittivity=1.6)
        return simulate_photos(PhotosSpec(), (wall,), seed=options.seed)
    source, read_options = Path(options.source), LosOptions(mask_threshold=options.mask_threshold)
    if not any(source.glob("*_par.txt")):
        return load_photos(source, read_options).photos
    with TemporaryDirectory() as folder:
        return load_photos(convert_middlebury(source, Path(folder)), read_options).photos


def parse_arguments():
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("source")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--mask-threshold", type=float)
    parser.add_argument("--bounds", type=float, nargs=6)
    parser.add_argument("--box", type=float, nargs=3, help="true sides about the origin [m]")
    parser.add_argument("--hold-out", type=int, default=HOLD_OUT, help="every so many")
    parser.add_argument("--preset", default="default", choices=get_args(PhotoPreset))
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--out", type=Path, help="folder for mesh.ply, views.png, surface, scores")
    return parser.parse_args()


def main():
    options = parse_arguments()
    torch.set_num_threads(options.threads)
    photos = read(options)
    held = np.arange(len(photos)) % options.hold_out == options.hold_out - 1
    config = photo_config(options.preset, options.seed)

    def show(trainer, losses):
        if trainer.step_number % 100 == 0:
            terms = "  ".join(f"{name} {value:.4f}" for name, value in losses.items())
            print(f"{trainer.step_number}/{trainer.n_steps}  {terms}", flush=True)

    wall_s, cpu_s = time.perf_counter(), time.process_time()
    surface = train_neural_surface(photos.subset(np.nonzero(~held)[0]), config, progress=show)
    mesh = surface.mesh()
    wall_s, cpu_s = time.perf_counter() - wall_s, time.process_time() - cpu_s
    names = [name for name, out in zip(photos.names, held, strict=True) if out]
    held_out = photos.subset(np.nonzero(held)[0])
    scores, picture = score_views(surface, held_out, names, options.mask_threshold)
    result = {
        "source": options.source,
        "n_photos": int((~held).sum()),
        "threads": options.threads,
        "cpus": os.cpu_count(),
        "wall_s": wall_s,
        "cpu_s": cpu_s,
        "peak_memory_mib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / MIB,
        "mesh": mesh_facts(mesh, options.bounds),
        "held_out": scores,
        "held_out_mean": mean_scores(scores),
    }
    size_m = (SIDE_M,) * 3 if options.source == "carton" else options.box
    if size_m is not None:
        result["error"] = box_errors(mesh, size_m)
    print(json.dumps(result, indent=2))
    if options.out is not None:
        options.out.mkdir(parents=True, exist_ok=True)
        write_mesh(mesh, options.out / "mesh.ply", frame=surface.frame)
        write_image(options.out / "views.png", picture)
        (options.out / "scores.json").write_text(json.dumps(result, indent=2) + "\n")


if __name__ == "__main__":
    main()
