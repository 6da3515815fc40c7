"""Effect of learned reflectivity on heat maps of planes that were left out.

    python bench/python/novel_views.py OUT SCENE ... [--preset best] [--hold-out 60 180 300]

A surface of each scene (folders with los.ply, such as those of `paper_claims.py scenes`) is
rendered with one reflectivity and with learned ones. Prints the mean PSNR of the planes that were
left out, and the gain: mean over scenes with its 95 % interval (Student's t). What lies in OUT is
not reconstructed again.
"""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.stats import t as student

import geraf2
from geraf2.io.container import LOS_NAME


def mean_psnr(run: geraf2.Reconstruction, options: geraf2.RenderOptions) -> float:
    """Mean over the planes that a run left out [dB]."""
    return float(np.mean([plane.psnr_db for plane in geraf2.render(run, options, num_threads=1)]))


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("scenes", type=Path, nargs="+")
    parser.add_argument("--preset", default="best", choices=["best", "fast"])
    parser.add_argument("--hold-out", type=float, nargs="+", default=[60.0, 180.0, 300.0])
    options = parser.parse_args()
    left_out = geraf2.RunOptions(hold_out=tuple(options.hold_out))
    learned = geraf2.RenderOptions()
    alike = replace(learned, echo=replace(learned.echo, n_nodes=1))
    print(f"{'scene':20} one [dB] learned [dB] gain [dB]")
    gains = []
    for scene in options.scenes:
        run = geraf2.reconstruct(
            scene,
            scene / LOS_NAME,
            options.preset,
            options.out / scene.name,
            options=left_out,
            num_threads=1,
        )
        one, many = mean_psnr(run, alike), mean_psnr(run, learned)
        gains.append(many - one)
        print(f"{scene.name:20} {one:8.1f} {many:12.1f} {gains[-1]:9.2f}", flush=True)
    n = len(gains)
    half = student.ppf(0.975, n - 1) * np.std(gains, ddof=1) / n**0.5 if n > 1 else np.nan
    print(f"{'mean, 95 % interval':20} {'':8} {'':12} {np.mean(gains):9.2f} +- {half:.2f}")


if __name__ == "__main__":
    main()
