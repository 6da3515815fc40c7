"""Import of a capture of another format into a scene folder."""

from collections import deque
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from geraf2._types import Progress
from geraf2.apps.importers import ImportOptions, Scan, load_importer
from geraf2.imaging.phase_sign import PhaseSign, SignSample, find_phase_sign
from geraf2.io.container import SceneReader, require_scene_folder
from geraf2.io.manifest import DELAY_KEY, RadarManifest
from geraf2.io.samples import complex_pose, conjugate_samples
from geraf2.io.scene_writer import SceneWriter
from geraf2.pipeline.events import Listener
from geraf2.records import RawPose
from geraf2.scene.checks import require_plausible
from geraf2.scene.store import capture_without_poses
from geraf2.scene.summary import CaptureSummary, summarize_in_parts

# Antennas scattered over some poses, from which the sign is estimated; it uses 512.
_N_SCATTERED_ANTENNAS = 512


@dataclass(frozen=True, kw_only=True, eq=False)
class ImportedCapture:
    """Result of an import; the samples are in the scene."""

    scene: Path
    """Folder of the scene."""
    summary: CaptureSummary
    """Sizes, positions and levels of all poses, lengths in metres."""
    sign: PhaseSign
    """Sign of the phase, with its evidence."""
    facts: tuple[tuple[str, str], ...]
    """Names and values of what the importer estimated."""
    notes: tuple[str, ...]
    """Warnings: assumed defaults, skipped folders, a doubtful sign."""
    unchanged: bool
    """Whether the folder held this very scene before."""


def import_capture(
    format_name: str,
    source: Path | str,
    scene: Path | str,
    *,
    radar: RadarManifest | None = None,
    options: ImportOptions | None = None,
    overwrite: bool = False,
    num_threads: int | None = None,
    listener: Listener | None = None,
) -> ImportedCapture:
    """Read a capture of another format, check it, estimate the sign of its phase, write a scene.

    The capture is read in parts of a pose, twice unless the importer can read scattered antennas.
    Samples with phases exp(+j...) are conjugated.

    Parameters
    ----------
    format_name
        Name of an importer, as "dca1000"; an unknown one names all.
    source
        File or folder of the capture.
    scene
        Folder to write, whole or not at all; the same scene there stays untouched.
    radar
        Parameters that the capture lacks, SI units [m, Hz]; they override its own.
    options
        Positions, configuration of the radar's software, treatment of broken parts.
    overwrite
        Replace another scene in the folder.
    num_threads
        Overrides that of `options`; all cores when both are None.
    listener
        Receives steps, notes and implausible values.

    Returns
    -------
    ImportedCapture
        Sizes, sign of the phase and notes; the samples are in the scene.

    Raises
    ------
    UserError
        Where the capture cannot be read or is implausible, or the folder holds something else.

    Examples
    --------
    >>> from scipy.io import savemat
    >>> pose, waveform = (capture := geraf2.examples.small_capture()[0]).poses[0], capture.waveform
    >>> names = ("start_frequency_hz", "chirp_slope_hz_per_s", "sample_rate_hz", "path_bias_m")
    >>> savemat("scan.mat", {"signal": pose.signal, "tx_positions": pose.tx_positions,
    ...                      "rx_positions": pose.rx_positions,
    ...                      **{name: getattr(waveform, name) for name in names}})
    >>> found = geraf2.import_capture("mat", "scan.mat", "imported")
    >>> found.summary.n_antennas, found.sign.sign
    (441, -1)
    """
    listener = listener or Listener()
    options = options or ImportOptions()
    options = replace(options, num_threads=num_threads or options.num_threads)
    scan = load_importer(format_name).open(Path(source), radar or RadarManifest(), options)
    base = capture_without_poses(scan.manifest)
    may_be_same = partial(_may_be_same, scan)
    require_scene_folder(Path(scene), overwrite=overwrite, may_be_same=may_be_same)
    summarize = partial(
        summarize_in_parts,
        n_antennas=scan.n_antennas,
        waveform=base.waveform,
        walls=base.walls,
        delay_given=DELAY_KEY in base.provenance,
    )
    summary = None
    if scan.thinned is None:
        sample = SignSample(scan.n_antennas)
        with listener.step("checking") as report:
            summary = summarize(_sample_poses(scan, sample, report))
        require_plausible(summary, source)
        some = sample.poses()
    else:
        some = [complex_pose(pose) for pose in scan.thinned(_N_SCATTERED_ANTENNAS)]
    with listener.step("finding the sign of the phase"):
        stated = options.phase_sign or scan.phase_sign
        sign = find_phase_sign(some, base.waveform, stated=stated, num_threads=options.num_threads)
        sign = replace(sign, is_forced=options.phase_sign is not None)
    if sign.is_positive:  # its echoes lie on the other side of the spectrum
        summary = None
    writer = _writer(scan, Path(scene), sign, overwrite=overwrite)
    with writer, listener.step("writing" if summary else "checking and writing") as report:
        parts = _write_parts(scan, writer, sign, report)
        if summary is None:
            summary = summarize(parts)
        else:
            deque(parts, maxlen=0)
        findings = require_plausible(summary, source)
    notes = (*scan.notes, *sign.doubts)
    for note in notes:
        listener.warning(note)
    listener.findings(findings)
    return ImportedCapture(
        scene=Path(scene),
        summary=summary,
        sign=sign,
        facts=scan.facts,
        notes=notes,
        unchanged=writer.unchanged,
    )


def _may_be_same(scan: Scan, old: SceneReader) -> bool:
    same_sizes = tuple(old.n_antennas) == tuple(scan.n_antennas)
    return same_sizes and old.manifest.waveform == scan.manifest.waveform


def _sample_poses(scan: Scan, sample: SignSample, report: Progress) -> Iterator[RawPose]:
    """All parts; some of their antennas are added to the sample."""
    for number, part, done in scan_parts(scan):
        sample.add(number, part)
        yield part
        report(done)


def scan_parts(scan: Scan) -> Iterator[tuple[int, RawPose, float]]:
    """Poses, or parts of them: number of the pose, antennas, fraction done."""
    number, n_so_far, n_done = 0, 0, 0
    total = max(1, sum(scan.n_antennas))
    for part in scan.poses():
        n_so_far += part.n_antennas
        n_done += part.n_antennas
        yield number, part, n_done / total
        if n_so_far >= scan.n_antennas[number]:
            number, n_so_far = number + 1, 0


def _writer(scan: Scan, scene: Path, sign: PhaseSign, *, overwrite: bool) -> SceneWriter:
    provenance = {**scan.manifest.provenance, **sign.provenance}
    return SceneWriter(
        scene,
        scan.manifest.model_copy(update={"provenance": provenance}),
        n_poses=len(scan.n_antennas),
        n_antennas_max=max(scan.n_antennas),
        overwrite=overwrite,
        integers=scan.integers,
    )


def _write_parts(
    scan: Scan, writer: SceneWriter, sign: PhaseSign, report: Progress
) -> Iterator[RawPose]:
    """All parts, each written by one thread while another reads the next."""
    parts = scan_parts(scan)
    with ThreadPoolExecutor(1) as readers, ThreadPoolExecutor(1) as writers:
        coming, writing = readers.submit(next, parts, None), None
        while (item := coming.result()) is not None:
            coming = readers.submit(next, parts, None)
            number, part, done = item
            if sign.is_positive:
                part = replace(part, signal=conjugate_samples(part.signal))
            if writing is not None:
                writing.result()
            writing = writers.submit(writer.append, part, n_antennas=scan.n_antennas[number])
            yield part
            report(done)
        if writing is not None:
            writing.result()
