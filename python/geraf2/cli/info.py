"""`geraf2 info`: what is in a scene or a raw recording, and what is odd about it."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from geraf2.cli._console import Positional, print_findings, rows, warn
from geraf2.cli._estimates import image_estimate, reconstruct_estimate
from geraf2.io.container import SceneReader
from geraf2.io.importers import ImportOptions
from geraf2.io.importers.dca1000 import open_recording
from geraf2.io.manifest import RadarManifest, read_manifest
from geraf2.scene.checks import check_capture
from geraf2.scene.store import capture_without_poses, pose_from_arrays
from geraf2.scene.summary import CaptureSummary, summarize_poses


@dataclass(frozen=True, kw_only=True)
class Config:
    """Show what is in a scene, what a run will take, and what is implausible.

    Of a raw recording (.bin) it shows how it is stored, with the evidence.
    """

    scene: Positional[Annotated[Path, tyro.conf.arg(metavar="SCENE")]]
    """Scene folder, or raw recording of a DCA1000."""
    radar: Path | None = None
    """TOML file with radar parameters, for a raw recording."""
    config: tuple[Path, ...] = ()
    """Configuration files of the radar's own software, for a raw recording."""


def main(config: Config) -> int:
    """Run the command."""
    if config.scene.suffix == ".bin" and config.scene.is_file():
        return _show_recording(config)
    reader = SceneReader(config.scene)
    base = capture_without_poses(reader.manifest)
    poses = (pose_from_arrays(reader.read_pose(index)) for index in range(reader.n_poses))
    summary = summarize_poses(poses, base.waveform, base.walls)
    rows(
        [
            ("scene", str(config.scene)),
            ("frame", f"{reader.manifest.frame} (metres)"),
            *((name, text) for name, text in sorted(reader.manifest.provenance.items())),
            *describe(summary),
            ("reconstruct takes about", str(reconstruct_estimate(summary))),
            ("image takes about", str(image_estimate(summary))),
        ]
    )
    print_findings(check_capture(summary))
    return 0


def _show_recording(config: Config) -> int:
    radar = read_manifest(RadarManifest, config.radar) if config.radar else RadarManifest()
    options = ImportOptions(config=config.config, keep_good=True)
    recording = open_recording(config.scene, radar, options)
    rows([("recording of", str(config.scene)), *recording.facts])
    for note in recording.notes:
        warn(note)
    return 0


def describe(summary: CaptureSummary) -> list[tuple[str, str]]:
    """Names and values of everything worth knowing about a capture."""
    waveform = summary.waveform
    width, height = summary.aperture_m
    counts = sorted({pose.n_antennas for pose in summary.poses})
    per_pose = (
        f"{counts[0]} to {counts[-1]}" if len(counts) > 1 else f"{counts[0] if counts else 0}"
    )
    focus = summary.focus
    looked_at = "unknown"
    if focus is not None:
        looked_at = f"({focus[0]:.3f}, {focus[1]:.3f}, {focus[2]:.3f}) m"
    verdict = "finer" if summary.spacing_m <= summary.nyquist_spacing_m else "coarser"
    width_text = summary.scene_width_m
    scene = f"a scene {width_text:g} m wide" if width_text else "any scene"
    return [
        ("poses", str(len(summary.poses))),
        ("antennas", f"{summary.n_antennas} ({per_pose} per pose)"),
        ("samples", str(waveform.n_samples)),
        (
            "band",
            f"{waveform.start_frequency_hz / 1e9:.4g} GHz + {waveform.bandwidth_hz / 1e9:.3g} GHz, "
            f"wavelength {1e3 * waveform.center_wavelength_m:.2f} mm",
        ),
        ("range cell", f"{1e3 * waveform.range_cell_m:.1f} mm"),
        ("unambiguous range", f"{waveform.unambiguous_range_m:.2f} m"),
        ("instrument delay", f"{waveform.path_bias_m:g} m on the two-way path"),
        ("aperture", f"{1e3 * width:.0f} x {1e3 * height:.0f} mm (horizontal x vertical)"),
        (
            "antenna spacing",
            f"{1e3 * summary.spacing_m:.2f} mm, {verdict} than the Nyquist spacing "
            f"{1e3 * summary.nyquist_spacing_m:.2f} mm of {scene}",
        ),
        ("poses look at", f"{looked_at} from {summary.standoff_m:.3f} m"),
        *(
            (
                f"wall {number}",
                " x ".join(f"{1e3 * side:.0f}" for side in wall.size_m)
                + f" mm, {1e3 * wall.thickness_m:g} mm thick, permittivity {wall.permittivity:g}",
            )
            for number, wall in enumerate(summary.walls, start=1)
        ),
    ]
