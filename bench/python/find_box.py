"""The box that a scan shows by itself, against the true one; and what it costs in F1.

    python bench/python/find_box.py SCENE... [--yaw] [--preset best [--wrong]] [--out out/find_box]

Each scene has the true box as los.ply and the true content as truth.ply (or truth_object.ply)
beside it, as `geraf2 simulate` and `geraf2 benchmark --only population` write them. What scene.toml
states of the box's size is left out. `--yaw` turns scan, box and content together by an angle that
the scene's name draws, as if the box stood turned. With `--preset` each is reconstructed twice,
with the true box and without a prior, with `--wrong` also with a box whose sides are 8 mm longer,
turned by 12 degrees and moved by 20 mm; results are kept in `--out` and used again.
"""

import argparse
import json
import re
import time
import zlib
from dataclasses import replace
from pathlib import Path

import numpy as np

import geraf2
from geraf2.calibration.box_finder import BOX_VERSION, find_box
from geraf2.calibration.found_box import FoundBox, Seen
from geraf2.geometry.transforms import apply_rigid, rigid, triple
from geraf2.io.mesh import read_mesh
from geraf2.scene import Capture, LosPrior

_TURNED = re.compile(r"box_turn_deg ([-+.\d]+)")


def turn_about_z(degrees: float) -> np.ndarray:
    """Rotation of the scan about the vertical, (4, 4)."""
    cosine, sine = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    return rigid(np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]]), np.zeros(3))


def turned(capture: Capture, transform: np.ndarray) -> Capture:
    """Capture in a turned frame, its walls with thickness and permittivity only."""
    poses = tuple(
        replace(
            pose,
            tx_positions=apply_rigid(transform, pose.tx_positions),
            rx_positions=apply_rigid(transform, pose.rx_positions),
            axes=np.ascontiguousarray(pose.axes @ transform[:3, :3].T),
        )
        for pose in capture.poses
    )
    walls = tuple(replace(wall, size_m=(0.1, 0.1, 0.1)) for wall in capture.walls[:1])
    return replace(capture, poses=poses, walls=walls)


def compared(found: FoundBox, truth: LosPrior, turn_deg: float) -> dict:
    """Errors of a found box, faces that were seen and those that were not apart."""
    assert truth.cuboid is not None
    axes, size, center = truth.cuboid
    axes = axes @ turn_about_z(turn_deg)[:3, :3].T
    cosines = np.abs(found.axes @ axes.T)
    order = cosines.argmax(axis=1)
    half, middle = 0.5 * size[order], found.axes @ center
    offsets = np.stack([half - middle, half + middle], axis=1)
    square = found.seen == Seen.SQUARELY
    # The rotation about the vertical alone: what a box leans by is no error of its yaw.
    flat = found.axes[0] - found.axes[0, 2] * np.array([0.0, 0.0, 1.0])
    yaw = float(
        np.rad2deg(np.arccos(np.clip(np.abs(axes @ flat).max() / np.linalg.norm(flat), 0, 1)))
    )
    both = square.all(axis=1)
    inside = (found.bounds_m[..., 0] <= offsets) & (offsets <= found.bounds_m[..., 1])
    covered = np.abs(found.size_m - size[order]) < 1.96 * found.size_sigma_m
    off = found.offsets_m - offsets
    edges = found.seen == Seen.EDGES
    return {
        "size_mm": (1e3 * (found.size_m - size[order])[both]).round(2).tolist(),
        "size_covered": covered[both].tolist(),
        "yaw_deg": round(yaw, 3) if square[:2].any() else None,
        "yaw_covered": bool(yaw < 1.96 * found.yaw_sigma_deg),
        "edges_mm": (1e3 * off[edges]).round(1).tolist(),
        "unseen_mm": (1e3 * off[found.seen == Seen.NOT]).round(1).tolist(),
        "unseen_covered": inside[~square].tolist(),
    }


def wrong(box: LosPrior) -> LosPrior:
    """Another box: 8 mm longer, turned by 12 degrees, moved by 20 mm along the diagonal."""
    assert box.cuboid is not None
    axes, size, middle = box.cuboid
    turn = turn_about_z(12.0)[:3, :3]
    center = triple(middle + 0.020 / np.sqrt(3.0))
    return LosPrior.from_box(triple(size + 0.008), center, axes=axes @ turn.T)


def scores(capture: Capture, prior: LosPrior | None, truth, preset: str, trust: bool = True):
    """F1 at 5 mm; 0 where there is no result."""
    options = geraf2.RunOptions(trust_los=trust and prior is not None)
    try:
        result = geraf2.reconstruct(capture, prior, preset, options=options)
    except geraf2.UserError as error:
        print(f"    {error}")
        return 0.0
    return geraf2.evaluate(result, truth).f1(0.005)


def measured(scene: Path, yaw_deg: float, preset: str | None, with_wrong: bool) -> dict:
    """Numbers of one scene."""
    capture = geraf2.load_capture(scene)
    transform = turn_about_z(yaw_deg)
    scan = turned(capture, transform)
    box = LosPrior.from_mesh(read_mesh(scene / "los.ply")).move(transform)
    stated = _TURNED.search(capture.provenance.get("world", ""))
    row: dict = {"scene": scene.name, "yaw": yaw_deg, "planes": len(capture.poses)}
    start = time.process_time()
    try:
        found = find_box(scan)
    except geraf2.UserError as error:
        row["error"] = str(error)
    else:
        row |= compared(found, box, float(stated[1]) if stated else 0.0)
        row["text"] = str(found)
    row["cpu_s"] = round(time.process_time() - start, 2)
    if preset is not None:
        name = next(n for n in ("truth.ply", "truth_object.ply") if (scene / n).is_file())
        truth = read_mesh(scene / name)
        truth = replace(truth, vertices=apply_rigid(transform, truth.vertices))
        assert box.cuboid is not None
        sides = triple(box.cuboid[1])
        walls = tuple(replace(w, size_m=sides, center_m=box.center_m) for w in scan.walls)
        known = replace(scan, walls=() if yaw_deg else walls)
        row["f1_given"] = round(scores(known, replace(box, walls=walls), truth, preset), 4)
        row["f1"] = round(scores(replace(scan, walls=()), None, truth, preset), 4)
        if with_wrong:
            row["f1_wrong"] = round(scores(scan, wrong(box), truth, preset, False), 4)
    return row


def summary(rows: list[dict]) -> list[str]:
    """Print the values over all scenes."""
    found = [row for row in rows if "error" not in row]
    size = np.abs([e for row in found for e in row["size_mm"]])
    covered = [c for row in found for c in row["size_covered"]]
    yaw = np.array([row["yaw_deg"] for row in found if row["yaw_deg"] is not None])
    lines = [f"boxes found          {len(found)} of {len(rows)}"]
    if len(size):
        lines.append(
            f"sides seen squarely  {len(size)}: median {np.median(size):.2f} mm, within 1 mm "
            f"{np.mean(size < 1.0):.0%}, within 2 mm {np.mean(size < 2.0):.0%}, in their 95 % "
            f"interval {np.mean(covered):.0%}"
        )
    if len(yaw):
        lines.append(
            f"yaw                  median {np.median(yaw):.2f} degrees, within 0.3 "
            f"{np.mean(yaw < 0.3):.0%}, in its interval "
            f"{np.mean([row['yaw_covered'] for row in found if row['yaw_deg'] is not None]):.0%}"
        )
    for name, kind in (("edges", "edges_mm"), ("not seen", "unseen_mm")):
        errors = np.array([e for row in found for e in row[kind]])
        if len(errors):
            low, middle, high = np.percentile(errors, [5, 50, 95])
            lines.append(
                f"faces by {name}".ljust(21) + f"{len(errors)}: error {middle:.1f} mm in the "
                f"median, {low:.1f} to {high:.1f} in 90 %"
            )
    lines.append(f"CPU seconds          median {np.median([row['cpu_s'] for row in rows]):.2f}")
    for key, name in (("f1", "without a prior"), ("f1_wrong", "with a wrong box")):
        both = np.array([(row["f1_given"], row[key]) for row in rows if key in row])
        if len(both):
            change = both[:, 1] - both[:, 0]
            lines.append(
                f"F1 5 mm              {both[:, 0].mean():.4f} with the true box, "
                f"{both[:, 1].mean():.4f} {name}; {change.mean():+.4f}, worst {change.min():+.3f}"
            )
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("scenes", nargs="+", type=Path)
    parser.add_argument("--yaw", action="store_true")
    parser.add_argument("--preset")
    parser.add_argument("--wrong", action="store_true")
    parser.add_argument("--out", type=Path, default=Path("out/find_box"))
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    rows = []
    for scene in args.scenes:
        yaw = zlib.crc32(scene.name.encode()) % 9000 / 100.0 - 45.0 if args.yaw else 0.0
        kept = (
            args.out
            / f"{scene.name}-{yaw:g}-{args.preset}-{BOX_VERSION}{'-wrong' * args.wrong}.json"
        )
        if not kept.is_file():
            kept.write_text(json.dumps(measured(scene, yaw, args.preset, args.wrong)))
        rows.append(json.loads(kept.read_text()))
        print(json.dumps(rows[-1]), flush=True)
    print("\n".join(summary(rows)))


if __name__ == "__main__":
    main()
