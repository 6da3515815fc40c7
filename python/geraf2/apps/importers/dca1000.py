"""Raw ADC samples of a TI board, as recorded by a DCA1000 capture card.

The source is one .bin file, or a folder with the parts of one recording or with one file for each
position. The order of the words and the samples per chirp are estimated where not given. The
positions come from a robot log or a raster, or the radar stood still. Stretches of a log with times
between which the board turns are planes.
"""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from geraf2._types import Floats
from geraf2.apps.importers import NO_OPTIONS, ImportOptions, Scan
from geraf2.apps.importers._board import Board, board_of, scan_antennas
from geraf2.apps.importers._raw_layout import MIN_RATIO
from geraf2.apps.importers._recording import Recording, is_kept, open_recording, read_positions
from geraf2.apps.importers._robot_log import RobotLog, read_log
from geraf2.apps.importers._rows import require_equal
from geraf2.apps.importers._scene_manifest import scene_manifest
from geraf2.apps.importers._tracks import (
    Track,
    divide_at_turns,
    log_track,
    planes_of,
    raster_track,
    remove_positions,
)
from geraf2.errors import UserError
from geraf2.io.container import join_parts
from geraf2.io.manifest import RadarManifest
from geraf2.records import RawPose, Samples

# Bytes of scattered frames that are read before all others: 30 ms.
_SOME_BYTES = 1 << 25


class Dca1000Importer:
    """Reads raw captures of TI boards."""

    def open(self, source: Path, radar: RadarManifest, options: ImportOptions = NO_OPTIONS) -> Scan:
        """Estimate layout and frames, check the positions; see Importer.open."""
        recording = open_recording(source, radar, options)
        if options.positions is None:
            return scan_of("dca1000", recording, radar, options, log=None)
        log = read_log(options.positions, keep_good=options.keep_good)
        period_s = radar.raw.frame_period_s or recording.config.frame_period_s
        is_one = log.times_s is None or log.scan is not None or recording.n_positions is not None
        period_s = None if is_one else period_s
        return scan_of("dca1000", recording, radar, options, log=log, period_s=period_s)


def scan_of(
    name: str,
    recording: Recording,
    radar: RadarManifest,
    options: ImportOptions,
    *,
    log: RobotLog | None,
    period_s: float | None = None,
) -> Scan:
    """Scan of a recording with its positions.

    name: of the importer.
    log: positions, where there is no raster and the radar moved.
    period_s: time between frames, where stretches between turns of the board are planes.
    """
    evidence, config = recording.evidence, recording.config
    _require_single_positions(recording, radar)
    per_complex, rate = evidence.order.per_complex, config.sample_rate_hz
    # Given values are those of the samples as stored, which are complex ones from here on.
    made = {
        "sample_rate_hz": radar.sample_rate_hz and radar.sample_rate_hz / per_complex,
        "n_samples": radar.n_samples and radar.n_samples // per_complex,
    }
    manifest, notes = scene_manifest(
        name,
        recording.source,
        radar.model_copy(update=made),
        {
            "start_frequency_hz": config.first_sample_hz(),
            "chirp_slope_hz_per_s": config.chirp_slope_hz_per_s,
            "sample_rate_hz": rate / per_complex if rate else None,
            "n_samples": evidence.n_samples,
            "path_bias_m": config.path_bias_m,
        },
        provenance=dict(recording.facts),
    )
    waveform = manifest.waveform
    half_sweep_s = 0.5 * (waveform.n_samples - 1) / waveform.sample_rate_hz
    board = board_of(
        scan_antennas(radar.antennas, log, recording.n_tx, evidence.order.n_rx),
        n_tx=recording.n_tx,
        n_rx=evidence.order.n_rx,
        center_hz=waveform.start_frequency_hz + half_sweep_s * waveform.chirp_slope_hz_per_s,
    )
    track = _track(recording, radar, options, board, log)
    track = divide_at_turns(track, period_s) if period_s else track
    tracks = planes_of(remove_positions(track, recording.missing_positions))
    per_position = recording.n_tx * evidence.order.n_rx
    return Scan(
        manifest=manifest,
        n_antennas=tuple(
            per_position * sum(stop - first for first, stop in own.ranges) for own in tracks
        ),
        poses=lambda: (part for own in tracks for part in read_pose(recording, own, board)),
        thinned=lambda n_antennas: [
            _read_some(recording, own, board, -(-n_antennas // len(tracks))) for own in tracks
        ],
        notes=(*recording.notes, *notes, *board.notes, *track.notes),
        facts=(*recording.facts, ("positions", track.text)),
        integers=is_kept(recording, track.frames_per_position),
        phase_sign=_phase_sign(evidence.energy_ratio),
    )


def _require_single_positions(recording: Recording, radar: RadarManifest) -> None:
    """Raise UserError where transmitters send together and cannot be separated."""
    found = recording.config.transmitters
    if found is None or found.take_turns or recording.decoder is not None or radar.raw.n_tx:
        return
    raise UserError(
        what=f"transmitters send together and have no position of their own: {found}",
        where=recording.source,
        expected="one transmitter a chirp, or as many chirps as transmitters with BPM codes",
        hint="give n_tx under [raw] of --radar, and tx_offsets_m of the point between them",
    )


def _phase_sign(energy_ratio: float) -> int | None:
    """Sign of the phase: with exp(+j...) positive delays have positive beat frequencies."""
    if max(energy_ratio, 1 / energy_ratio) < MIN_RATIO:
        return None
    return 1 if energy_ratio > 1 else -1


def _track(
    recording: Recording,
    radar: RadarManifest,
    options: ImportOptions,
    board: Board,
    log: RobotLog | None,
) -> Track:
    sources = [log is not None, radar.raster is not None, options.static]
    if sum(sources) != 1:
        raise UserError(
            what="a raw capture holds no positions of the radar"
            if not any(sources)
            else "positions, raster and static exclude each other",
            where=recording.source,
            expected="one of --positions LOG.csv, --raster ROWS COLUMNS ROW_STEP COLUMN_STEP, "
            "--static",
            hint=f"'geraf2 info {recording.source}' shows a recording without",
        )
    n_frames, n_positions = recording.n_frames, recording.n_positions
    if options.static:
        if n_positions is not None:
            raise UserError(what="--static has one position, --file-per-position has many")
        text = f"one position, {n_frames} frames averaged"
        return Track(frames_per_position=n_frames, text=text)
    if radar.raster is not None:
        where, keep_good = recording.source, options.keep_good
        on_raster = radar.raster.n_rows * radar.raster.n_columns
        if n_positions is not None:
            what = "files and positions of the raster differ in number"
            require_equal(what, where, on_raster, n_positions)
        return raster_track(radar.raster, board.axes, n_frames, keep_good=keep_good, where=where)
    assert log is not None  # one of the three
    if n_positions is not None:
        what = "files and positions differ in number"
        require_equal(what, log.path, n_positions, len(log.positions))
        log = replace(log, times_s=None)  # files and positions have the same order
    chirp_s, n_tx = radar.raw.chirp_s or 0.0, recording.n_tx
    return log_track(
        log,
        n_frames,
        tx_delays_s=tuple(chirp_s * (k - 0.5 * (n_tx - 1)) for k in range(n_tx) if chirp_s),
        frame_period_s=radar.raw.frame_period_s or recording.config.frame_period_s,
        start_time_s=radar.raw.start_time_s,
        keep_good=options.keep_good,
    )


def read_pose(recording: Recording, track: Track, board: Board) -> Iterator[RawPose]:
    """Parts of one pose of a recording, each a block of the file."""
    axes = board.mean_axes(track)
    for first_position, stop_position in track.ranges:
        for position, signal in read_positions(
            recording, first_position, stop_position, track.frames_per_position
        ):
            yield _part(recording, track, board, axes, position, signal)


def _part(
    recording: Recording, track: Track, board: Board, axes: Floats, position: int, signal: Samples
) -> RawPose:
    """Pose of consecutive positions, from samples (n_positions, n_tx, n_rx, n_samples, ...)."""
    stop = position + len(signal)
    positions, rotations = track.at(position, stop)
    if track.tx_positions is not None:
        positions = track.tx_positions[position:stop]
    tx, rx = board.antennas(positions, rotations)
    return RawPose(
        signal=signal.reshape(-1, *signal.shape[3:]),
        tx_positions=tx,
        rx_positions=rx,
        axes=axes,
        name=recording.source.name,
    )


def _read_some(recording: Recording, track: Track, board: Board, n_antennas: int) -> RawPose:
    """About `n_antennas` antennas at random positions, of _SOME_BYTES at most."""
    positions = np.concatenate([np.arange(*usable) for usable in track.ranges])
    wanted = -(-n_antennas // (recording.n_tx * recording.evidence.order.n_rx))
    affordable = max(1, _SOME_BYTES // recording.frame_bytes)
    n_positions = min(wanted, affordable, len(positions))
    n_frames = min(track.frames_per_position, max(1, affordable // n_positions))
    axes, parts = board.mean_axes(track), []
    for position in np.sort(np.random.default_rng(0).choice(positions, n_positions, replace=False)):
        first = int(position) * track.frames_per_position
        frames = recording.read_frames(first, first + n_frames)
        signal = np.asarray(frames.mean(axis=(0, 1)))[None]
        parts.append(_part(recording, track, board, axes, int(position), signal))
    return join_parts(parts)
