"""`geraf2 import`: a capture of another format becomes a scene."""

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np

from geraf2.calibration.phase_sign import PhaseSign, find_phase_sign
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
from geraf2.cli._fields import Arg
from geraf2.errors import UserError
from geraf2.io.container import PoseArrays, SceneWriter
from geraf2.io.importers import ImportOptions, Scan, load_importer
from geraf2.io.manifest import (
    RadarManifest,
    RasterManifest,
    SceneManifest,
)
from geraf2.io.samples import conjugated_samples
from geraf2.io.toml import from_table, read_toml
from geraf2.scene import Capture, Pose
from geraf2.scene.checks import require_plausible
from geraf2.scene.store import capture_without_poses, pose_from_arrays
from geraf2.scene.summary import CaptureSummary, summarize_in_parts

# Evenly spread poses whose focus decides on the sign of the phase, and about how many antennas of
# each are held: find_phase_sign takes 512 of them at random. Even steps need more to draw from,
# because they may fall in with the rows of a raster.
_N_SIGN_POSES = 4
_N_SIGN_ANTENNAS, _N_SCATTERED_ANTENNAS = 4096, 512


@dataclass(frozen=True, kw_only=True)
class Config:
    """Turn a capture of another format into a scene; checks it and finds the phase sign."""

    format: Positional[Annotated[str, Arg(metavar="FORMAT")]]
    """Format of the capture: dca1000, geraf-sens, mat, mmnorm, planar, or one of a plug-in."""
    source: Positional[Annotated[Path, Arg(metavar="SRC")]]
    """Folder or file of the capture."""
    scene: Positional[Annotated[Path, Arg(metavar="SCENE")]]
    """Folder to make."""
    radar: Path | None = None
    """TOML file with radar parameters that the capture lacks; they go before its own."""
    config: tuple[Path, ...] = ()
    """Configuration files of the radar's own software: *.mmwave.json, cf.json, *.cfg."""
    positions: Path | None = None
    """Robot log, CSV or NPY: time_s, x_m, y_m, z_m, optionally qw, qx, qy, qz."""
    raster: Annotated[
        tuple[int, int, float, float] | None,
        Arg(metavar="ROWS COLUMNS ROW_STEP_M COLUMN_STEP_M"),
    ] = None
    """The radar went over a raster, row by row."""
    serpentine: bool = False
    """Every other row of the raster was scanned backwards."""
    static: bool = False
    """The radar stood still: all frames are averaged."""
    keep_good: bool = False
    """Leave out what is broken (a last frame cut short, rows with NaN, ...), with a note."""
    overwrite: bool = False
    """Replace another scene in this folder."""
    threads: Threads = None
    """Threads to use; all when not given."""


def main(config: Config) -> int:
    """Run the command."""
    radar = _radar(config)
    num_threads = require_threads(config.threads)
    options = ImportOptions(
        positions=config.positions,
        config=config.config,
        static=config.static,
        keep_good=config.keep_good,
        num_threads=num_threads,
    )
    scan = load_importer(config.format).open(config.source, radar, options)
    base = capture_without_poses(scan.manifest)
    summary = None
    if scan.thinned is None:
        some, summary = _first_pass(scan, base)
        require_plausible(summary, config.source)
    else:
        some = [pose_from_arrays(pose) for pose in scan.thinned(_N_SCATTERED_ANTENNAS)]
    with progress_bar("finding the sign of the phase"):
        sign = find_phase_sign(some, base.waveform, num_threads=num_threads)
    is_positive = _is_positive(scan, sign)
    manifest = _with_sign(scan, sign, is_positive)
    writer = SceneWriter(
        config.scene,
        manifest,
        n_poses=len(scan.n_antennas),
        n_antennas_max=max(scan.n_antennas),
        overwrite=config.overwrite,
        integers=scan.integers,
    )
    label = "writing" if summary else "checking and writing"
    with writer, progress_bar(label) as report:
        parts = _written(scan, writer, is_positive, report)
        if summary is None:
            summary = summarize_in_parts(parts, scan.n_antennas, base.waveform, base.walls)
        else:
            deque(parts, maxlen=0)
        findings = require_plausible(summary, config.source)
    _report(config, scan, summary, manifest, sign, unchanged=writer.unchanged)
    print_findings(findings)
    return 0


def _first_pass(scan: Scan, base: Capture) -> tuple[list[Pose], CaptureSummary]:
    """Put some antennas of some poses aside, and take the numbers of all."""
    thinned: dict[int, list[Pose]] = {}
    with progress_bar("checking") as report:
        parts = _thinning(scan, thinned, report)
        summary = summarize_in_parts(parts, scan.n_antennas, base.waveform, base.walls)
    return [_joined(parts) for parts in thinned.values()], summary


def _written(
    scan: Scan,
    writer: SceneWriter,
    is_positive: bool,
    report: Callable[[float], None],
) -> Iterator[PoseArrays]:
    """All parts, each written while the next is read: one thread for either, and the caller's."""
    parts = _parts(scan)

    def read() -> tuple[int, PoseArrays, float] | None:
        item = next(parts, None)
        if item is None or not is_positive:
            return item
        number, part, done = item
        return number, replace(part, signal=conjugated_samples(part.signal)), done

    with ThreadPoolExecutor(1) as readers, ThreadPoolExecutor(1) as writers:
        coming, writing = readers.submit(read), None
        while (item := coming.result()) is not None:
            number, part, done = item
            coming = readers.submit(read)
            if writing is not None:
                writing.result()
            writing = writers.submit(writer.append, part, n_antennas=scan.n_antennas[number])
            yield part
            report(done)
        if writing is not None:
            writing.result()


def _radar(config: Config) -> RadarManifest:
    """radar.toml, with the raster of the command line."""
    radar = read_toml(config.radar, RadarManifest) if config.radar else RadarManifest()
    if config.raster is None:
        if config.serpentine and radar.raster is None:
            raise UserError(what="--serpentine needs --raster")
        return radar
    names = ("n_rows", "n_columns", "row_step_m", "column_step_m")
    values = {**dict(zip(names, config.raster, strict=True)), "serpentine": config.serpentine}
    return radar.model_copy(update={"raster": from_table(values, RasterManifest, "--raster")})


def _parts(scan: Scan) -> Iterator[tuple[int, PoseArrays, float]]:
    """Poses, or parts of them: number of the pose, antennas, fraction done after them."""
    number, n_so_far, n_done = 0, 0, 0
    total = max(1, sum(scan.n_antennas))
    for part in scan.poses():
        n_so_far += part.n_antennas
        n_done += part.n_antennas
        yield number, part, n_done / total
        if n_so_far >= scan.n_antennas[number]:
            number, n_so_far = number + 1, 0


def _thinning(
    scan: Scan, thinned: dict[int, list[Pose]], report: Callable[[float], None]
) -> Iterator[PoseArrays]:
    """All parts; puts some antennas of some poses aside, from which the sign is found."""
    step = max(1, len(scan.n_antennas) // _N_SIGN_POSES)
    chosen = range(0, len(scan.n_antennas), step)[:_N_SIGN_POSES]
    n_before: dict[int, int] = {}
    for number, part, done in _parts(scan):
        if number in chosen:
            every = max(1, scan.n_antennas[number] // _N_SIGN_ANTENNAS)
            before = n_before.get(number, 0)
            rows = np.arange(-before % every, part.n_antennas, every)
            n_before[number] = before + part.n_antennas
            some = replace(
                part,
                signal=part.signal[rows],
                tx_positions=part.tx_positions[rows],
                rx_positions=part.rx_positions[rows],
            )
            thinned.setdefault(number, []).append(pose_from_arrays(some))
        yield part
        report(done)


def _joined(parts: Sequence[Pose]) -> Pose:
    return replace(
        parts[0],
        signal=np.concatenate([part.signal for part in parts]),
        tx_positions=np.concatenate([part.tx_positions for part in parts]),
        rx_positions=np.concatenate([part.rx_positions for part in parts]),
    )


def _is_positive(scan: Scan, sign: PhaseSign) -> bool:
    """Whether the capture has to be conjugated; focusing decides where it can."""
    return (sign.sign if sign.is_clear or scan.phase_sign is None else scan.phase_sign) > 0


def _with_sign(scan: Scan, sign: PhaseSign, is_positive: bool) -> SceneManifest:
    evidence = str(sign)
    if not sign.is_clear and scan.phase_sign is not None:
        name = "exp(+j...), conjugated on import" if is_positive else "exp(-j...)"
        evidence = f"phase sign {name}: by the format or its spectrum; focusing does not decide"
    provenance = {
        **scan.manifest.provenance,
        "phase_sign": "+1" if is_positive else "-1",
        "phase_sign_evidence": evidence,
    }
    return scan.manifest.model_copy(update={"provenance": provenance})


def _report(
    config: Config,
    scan: Scan,
    summary: CaptureSummary,
    manifest: SceneManifest,
    sign: PhaseSign,
    *,
    unchanged: bool,
) -> None:
    waveform = summary.waveform
    evidence = manifest.provenance["phase_sign_evidence"]
    rows(
        [
            *scan.facts,
            ("poses", str(len(summary.poses))),
            ("antennas", str(summary.n_antennas)),
            ("samples", str(waveform.n_samples)),
            ("phase sign", evidence.removeprefix("phase sign ")),
            ("delay taken off", f"{waveform.path_bias_m:g} m on the two-way path"),
        ]
    )
    for note in scan.notes:
        warn(note)
    if not sign.is_clear and scan.phase_sign is None:
        warn("the sign of the phase is not clear: check the image, or the positions and delay")
    if sign.is_clear and scan.phase_sign not in (None, sign.sign):
        warn(
            "the image focuses with the sign of the phase that the format or the spectrum does "
            "not have: check the positions, the looking direction, and I and Q"
        )
    if unchanged:
        say(f"{config.scene} already holds this scene, nothing changed")
    else:
        say(f"wrote {config.scene}; see 'geraf2 info {config.scene}'")
