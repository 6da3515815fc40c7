"""`geraf2 import`: a capture of another format becomes a scene."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from geraf2.cli._console import (
    Positional,
    Threads,
    print_findings,
    progress_bar,
    require_threads,
    rows,
    say,
    warn,
)
from geraf2.imaging.phase_sign import PhaseSign, conjugated, find_phase_sign
from geraf2.io.container import PoseArrays, SceneWriter
from geraf2.io.importers import Scan, load_importer
from geraf2.io.manifest import RadarManifest, SceneManifest, read_manifest
from geraf2.scene import Pose, Waveform
from geraf2.scene.checks import require_plausible
from geraf2.scene.store import capture_without_poses, pose_from_arrays, pose_to_arrays
from geraf2.scene.summary import CaptureSummary, summarize_poses

# Evenly spread poses whose focus decides on the sign of the phase.
_N_SIGN_POSES = 4


@dataclass(frozen=True, kw_only=True)
class Config:
    """Turn a capture of another format into a scene; checks it and finds the phase sign."""

    format: Positional[Annotated[str, tyro.conf.arg(metavar="FORMAT")]]
    """Format of the capture, e.g. geraf-sens."""
    source: Positional[Annotated[Path, tyro.conf.arg(metavar="SRC")]]
    """Folder or file of the capture."""
    scene: Positional[Annotated[Path, tyro.conf.arg(metavar="SCENE")]]
    """Folder to make."""
    radar: Path | None = None
    """TOML file with radar parameters that the capture lacks; they go before its own."""
    overwrite: bool = False
    """Replace another scene in this folder."""
    threads: Threads = None
    """Threads to use; all when not given."""


def main(config: Config) -> int:
    """Run the command."""
    radar = read_manifest(RadarManifest, config.radar) if config.radar else RadarManifest()
    num_threads = require_threads(config.threads)
    scan = load_importer(config.format).open(config.source, radar)
    base = capture_without_poses(scan.manifest)
    with progress_bar("checking"):
        summary = summarize_poses(_poses(scan), base.waveform, base.walls)
    findings = require_plausible(summary, config.source)
    with progress_bar("finding the sign of the phase"):
        sign = _find_sign(scan, base.waveform, num_threads)
    manifest = _with_sign(scan.manifest, sign)
    writer = SceneWriter(
        config.scene,
        manifest,
        n_poses=len(scan.n_antennas),
        n_antennas_max=max(scan.n_antennas),
        overwrite=config.overwrite,
    )
    with writer, progress_bar("writing") as report:
        for number, pose in enumerate(_poses(scan), start=1):
            kept = pose if sign.sign < 0 else conjugated(pose)
            writer.append(pose_to_arrays(kept))
            report(number / len(scan.n_antennas))
    _report(config, scan, summary, sign, unchanged=writer.unchanged)
    print_findings(findings)
    return 0


def _poses(scan: Scan) -> Iterator[Pose]:
    return map(pose_from_arrays, scan.poses())


def _find_sign(scan: Scan, waveform: Waveform, num_threads: int | None) -> PhaseSign:
    n_poses = len(scan.n_antennas)
    step = max(1, n_poses // _N_SIGN_POSES)
    chosen: list[PoseArrays] = [p for i, p in enumerate(scan.poses()) if i % step == 0]
    return find_phase_sign(
        [pose_from_arrays(p) for p in chosen[:_N_SIGN_POSES]], waveform, num_threads=num_threads
    )


def _with_sign(manifest: SceneManifest, sign: PhaseSign) -> SceneManifest:
    provenance = {
        **manifest.provenance,
        "phase_sign": f"{sign.sign:+d}",
        "phase_sign_evidence": str(sign),
    }
    return manifest.model_copy(update={"provenance": provenance})


def _report(
    config: Config, scan: Scan, summary: CaptureSummary, sign: PhaseSign, *, unchanged: bool
) -> None:
    waveform = summary.waveform
    rows(
        [
            ("poses", str(len(summary.poses))),
            ("antennas", str(summary.n_antennas)),
            ("samples", str(waveform.n_samples)),
            ("phase sign", str(sign).removeprefix("phase sign ")),
            ("delay taken off", f"{waveform.path_bias_m:g} m on the two-way path"),
        ]
    )
    for note in scan.notes:
        warn(note)
    if not sign.is_clear:
        warn("the sign of the phase is not clear: check the image, or the positions and delay")
    if unchanged:
        say(f"{config.scene} already holds this scene, nothing changed")
    else:
        say(f"wrote {config.scene}; see 'geraf2 info {config.scene}'")
