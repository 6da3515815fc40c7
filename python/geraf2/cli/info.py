"""`geraf2 info`: content of a scene or a raw recording, and implausible values."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from shlex import quote
from typing import Annotated

import numpy as np

from geraf2._bounds import Arg
from geraf2.apps.importers import ImportOptions
from geraf2.apps.importers._bag import list_bag
from geraf2.apps.importers._recording import open_recording
from geraf2.cli._console import keep, print_findings, progress_bar, rows, say, threads, warn
from geraf2.cli._fields import Positional
from geraf2.cli._outcome import print_found, print_verdict
from geraf2.errors import UserError
from geraf2.freespace.coverage import ScanCoverage, summary_coverage
from geraf2.imaging.phase_sign import EVIDENCE_KEY
from geraf2.io.container import LOS_NAME, SceneReader, is_scene
from geraf2.io.manifest import CalibrationManifest, RadarManifest
from geraf2.io.mesh import read_mesh
from geraf2.io.outputs import PICTURES, require_file
from geraf2.io.ros import is_bag
from geraf2.io.run_folder import RUN_NAME, TRAINING_FOLDER
from geraf2.io.toml import read_toml
from geraf2.pipeline.estimates import (
    DEFAULT_IMAGE_SIDE_M,
    fine_image,
    image_estimate,
    reconstruct_estimate,
)
from geraf2.pipeline.reconstruction import load_run
from geraf2.scene.checks import check_capture, require_no_errors
from geraf2.scene.store import capture_without_poses
from geraf2.scene.summary import CaptureSummary, is_delay_given, summarize_poses


@dataclass(frozen=True, kw_only=True)
class Config:
    """Show the content of a scene, the cost of a run, and implausible values.

    Of a raw recording (.bin, or a folder of them) it shows how it is stored, with the evidence; of
    a ROS 2 bag its topics; of a run folder, what was found.
    """

    scene: Positional[Annotated[Path, Arg(metavar="SCENE")]]
    """Scene folder, raw recording of a DCA1000, ROS 2 bag, or run folder."""
    radar: Path | None = None
    """TOML file with radar parameters, for a raw recording."""
    config: tuple[Path, ...] = ()
    """Configuration files of the radar's own software, for a raw recording."""
    file_per_position: bool = False
    """The folder holds one recording a position."""
    figure: Annotated[Path | None, Arg(metavar="PNG")] = None
    """Draw antennas, box and heat map, ranges over time, sampling, and what cannot be seen."""


def main(config: Config) -> int:
    """Run the command."""
    if config.figure is not None:
        require_file(config.figure, PICTURES)
    if (config.scene / RUN_NAME).is_file() or (config.scene / TRAINING_FOLDER).is_dir():
        return _show_run(config.scene)
    show = _show_bag if is_bag(config.scene) else None
    show = _show_recording if _is_recording(config.scene) else show
    if show is not None:
        if config.figure is not None:
            hint = "import the recording first"
            raise UserError(what="--figure needs a scene", where=config.scene, hint=hint)
        return show(config)
    reader = SceneReader(config.scene)
    base = capture_without_poses(reader.manifest)
    poses = (reader.read_pose(index) for index in range(reader.n_poses))
    summary = summarize_poses(poses, base.waveform, base.walls, delay_given=is_delay_given(base))
    command = "image" if summary.is_plane else "reconstruct"
    takes = None if summary.is_plane else reconstruct_estimate(summary)
    los = reader.path / LOS_NAME
    coverage = summary_coverage(summary, read_mesh(los).vertices if los.is_file() else None)
    facts = [
        ("scene", str(config.scene)),
        ("frame", f"{reader.manifest.frame} (metres)"),
        *_origin(reader.manifest.provenance),
        *(_calibration_row(found) for found in reader.manifest.calibration),
        *describe(summary),
        *(_coverage_rows(coverage) if coverage else []),
        *([("reconstruct takes about", str(takes))] if takes else []),
        ("image takes about", str(image_estimate(summary))),
        ("a fine image", _fine_image(summary)),
        ("next", f"geraf2 {command} {quote(str(config.scene))} out"),
    ]
    rows(facts)
    findings = (*check_capture(summary), *(coverage.findings() if coverage else ()))
    keep({"scene": str(config.scene), "frame": reader.manifest.frame, **summary.numbers()})
    keep({"provenance": dict(reader.manifest.provenance)})
    keep({"coverage": coverage.numbers() if coverage else None})
    keep({"reconstruct": takes and asdict(takes), "image": asdict(image_estimate(summary))})
    print_findings(found for found in findings if found.severity != "error")
    require_no_errors(findings, config.scene)
    if config.figure is not None:
        _draw(config.figure, reader, summary, threads())
        say(f"picture  {config.figure}")
    return 0


def _origin(provenance: Mapping[str, str]) -> list[tuple[str, str]]:
    """Names and values of a scene's provenance; the evidence of the phase sign names it."""
    found = dict(provenance)
    evidence = found.pop(EVIDENCE_KEY, None)
    if evidence is not None:
        found["phase_sign"] = evidence.removeprefix("phase sign ")
    return [(key.replace("_", " "), text) for key, text in sorted(found.items())]


def _fine_image(summary: CaptureSummary) -> str:
    wavelength = summary.waveform.center_wavelength_m
    if summary.is_plane:
        sides = (*summary.aperture_m, 8.0 * wavelength)
    else:
        sides = (summary.scene_width_m or DEFAULT_IMAGE_SIDE_M,) * 3
    sizes = [pose.n_antennas for pose in summary.poses]
    return fine_image(sides, wavelength, sizes, summary.waveform.n_samples)


def _draw(path: Path, reader: SceneReader, summary: CaptureSummary, threads: int | None) -> None:
    """Draw the planes of a scene; reads every plane, and images a few."""
    from geraf2.report.overview import overview_figure  # noqa: PLC0415 - matplotlib takes 0.5 s

    los = reader.path / LOS_NAME
    box = read_mesh(los) if los.is_file() else None
    if not summary.usable_poses:
        raise UserError(what="has no antennas to draw", where=reader.path)
    if summary.focus is None and not summary.is_plane:
        what = "has one frequency, no ranges and no plane to draw"
        raise UserError(what=what, where=reader.path)
    with progress_bar("drawing"):
        poses = (reader.read_pose(index) for index in range(reader.n_poses))
        overview_figure(poses, summary, path, box=box, num_threads=threads)


def _is_recording(path: Path) -> bool:
    if path.is_dir():
        return not is_scene(path) and any(path.glob("*.bin"))
    return path.suffix == ".bin" and path.is_file()


def _show_run(path: Path) -> int:
    result, shown = load_run(path), quote(str(path))
    rows([("run of scene", result.run.scene_name), ("steps", ", ".join(result.run.stages))])
    if "mesh" not in result.run.stages:  # an image alone
        rows([("to make a surface", f"geraf2 reconstruct SCENE {shown}")])
        return 0
    print_found(result)
    page = [("page to open", str(result.report))] if result.report else []
    scores = ("scores", f"geraf2 evaluate {shown} --truth MESH")
    view = ("in 3D", f"geraf2 view {shown}")
    rows([*page, view, ("against a CAD model", f"geraf2 inspect {shown} --cad PART"), scores])
    return print_verdict(result.verdict)


def _show_bag(config: Config) -> int:
    found, lacks = list_bag(config.scene)
    line = f"geraf2 import rosbag {quote(str(config.scene))} scene --config FILES"
    rows([("bag", str(config.scene)), *found, *([] if lacks else [("to import it", line)])])
    for text in lacks:
        warn(f"{config.scene}: {text}")
    return 0


def _show_recording(config: Config) -> int:
    radar = read_toml(config.radar, RadarManifest) if config.radar else RadarManifest()
    how = ImportOptions(
        config=config.config, keep_good=True, file_per_position=config.file_per_position
    )
    recording = open_recording(config.scene, radar, how)
    rows([("recording of", str(config.scene)), *recording.facts])
    evidence = recording.evidence
    keep({"recording": str(config.scene), "facts": dict(recording.facts)})
    keep({**asdict(evidence.order), "n_samples": evidence.n_samples, "n_tx": recording.n_tx})
    keep({"n_loops": recording.n_loops, "n_frames": recording.n_frames})
    line = f"geraf2 import dca1000 {quote(str(config.scene))} scene --positions LOG --config FILES"
    rows([("to import it", line)])
    for note in recording.notes:
        warn(note)
    return 0


def _calibration_row(found: CalibrationManifest) -> tuple[str, str]:
    sigma = found.path_bias_sigma_m
    source = "kept" if found.delay_from == "kept" else f"from {found.delay_from}"
    parts = [f"delay {source}" + (f" (+- {1e3 * sigma:.1f} mm of path)" if sigma else "")]
    if found.prior_to_capture is not None:
        parts.append("prior and axis")
    if found.channel_phases_rad is not None:
        parts.append(f"phases of {len(found.channel_phases_rad)} channels")
    if found.position_coefficients_m is not None:
        parts.append("positions")
    return ("calibrated", f"{', '.join(parts)}; scene.toml has the numbers")


def _coverage_rows(found: ScanCoverage) -> list[tuple[str, str]]:
    """Names and values of what the planes can receive."""
    low, high = found.tilts_deg
    heights = " and ".join(
        f"{1e3 * start:z.0f} to {1e3 * end:z.0f}" for start, end in found.heights_m
    )
    upright = [("vertical faces", f"are seen at z = {heights} mm, where antennas stand")]
    return [
        (
            "normals seen",
            f"{100.0 * found.seen_share:.0f} % of all, tilted from {low:z.0f} to {high:z.0f} "
            "degrees; surfaces that face elsewhere are not seen",
        ),
        *(upright if heights else []),
    ]


def _describe_directions(summary: CaptureSummary) -> list[tuple[str, str]]:
    """Point that the planes face; of a single plane its resolution, as its depth needs focusing."""
    focus = summary.focus
    if summary.is_plane:
        x, y, z = summary.usable_poses[0].axes[0]
        width = max(summary.aperture_m)
        across, deep = np.array([0.5e3, 2e3]) * summary.waveform.center_wavelength_m
        return [
            (
                "plane looks along",
                f"({x:z.3g}, {y:z.3g}, {z:z.3g}); 'geraf2 image' finds the depth",
            ),
            (
                "focus",
                f"{across:.1f} mm across, {deep:.0f} mm in depth, {width:.2g} m away; at twice "
                f"that {2 * across:.1f} and {4 * deep:.0f} mm",
            ),
        ]
    if focus is None:
        return [("planes look at", "unknown")]
    looked_at = f"({focus[0]:z.3f}, {focus[1]:z.3f}, {focus[2]:z.3f}) m"
    return [("planes look at", f"{looked_at} from {summary.standoff_m:.3f} m")]


def describe(summary: CaptureSummary) -> list[tuple[str, str]]:
    """Names and values of a capture's properties."""
    waveform = summary.waveform
    width, height = summary.aperture_m
    ranges = waveform.n_samples > 1
    counts = sorted({pose.n_antennas for pose in summary.poses})
    per_pose = (
        f"{counts[0]} to {counts[-1]}" if len(counts) > 1 else f"{counts[0] if counts else 0}"
    )
    verdict = "coarser than" if summary.is_coarse else "within"
    steps = sorted({round(1e3 * step, 2) for step in summary.spacings_m if np.isfinite(step)})
    wide = summary.scene_width_m
    scene = f"a scene {wide:.3g} m wide" if wide else "any scene"
    return [
        ("planes", str(len(summary.poses))),
        ("antennas", f"{summary.n_antennas} ({per_pose} per plane)"),
        ("samples", str(waveform.n_samples)),
        (
            "band",
            f"{waveform.start_frequency_hz / 1e9:.4g} GHz"
            + (f" + {waveform.bandwidth_hz / 1e9:.3g} GHz" if ranges else "")
            + f", wavelength {1e3 * waveform.center_wavelength_m:.2f} mm",
        ),
        (
            "range cell",
            f"{1e3 * waveform.range_cell_m:.1f} mm" if ranges else "none: one frequency",
        ),
        *([("unambiguous range", f"{waveform.unambiguous_range_m:.2f} m")] if ranges else []),
        ("instrument delay", f"{waveform.path_bias_m:g} m on the two-way path"),
        ("aperture", f"{1e3 * width:.0f} x {1e3 * height:.0f} mm (horizontal x vertical)"),
        (
            "antenna spacing",
            f"{' x '.join(f'{step:.2f}' for step in steps)} mm, {verdict} the Nyquist spacing "
            f"{1e3 * summary.nyquist_spacing_m:.2f} mm of {scene}",
        ),
        *_describe_directions(summary),
        *(
            (
                f"wall {number}",
                " x ".join(f"{1e3 * side:.0f}" for side in wall.size_m)
                + f" mm, {1e3 * wall.thickness_m:.3g} mm thick, "
                f"permittivity {wall.permittivity:.3g}",
            )
            for number, wall in enumerate(summary.walls, start=1)
        ),
    ]
