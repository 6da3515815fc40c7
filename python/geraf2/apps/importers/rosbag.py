"""Raw ADC samples and poses of a ROS 2 bag: a rosbag2 folder, .mcap or .db3.

A message holds one frame in the order of a DCA1000, as an array of uint8, int16 or uint16. The
poses come from transforms, PoseStamped or Odometry, linear in position and slerp in rotation.
Stretches between which the board turns are planes. The offset between the clocks of radar and arm
is estimated from lines that run in opposite directions (apps.importers.clock_offset).
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from geraf2.apps.importers import NO_OPTIONS, ImportOptions, Scan
from geraf2.apps.importers._bag import Bag, read_bag
from geraf2.apps.importers._recording import Recording, open_recording
from geraf2.apps.importers._ti_config import find_ti_configs, read_ti_configs
from geraf2.apps.importers.clock_offset import (
    MAX_OFFSET_S,
    ClockOffset,
    Sweep,
    find_clock_offset,
    straight_lines,
)
from geraf2.apps.importers.dca1000 import scan_of
from geraf2.constants import SPEED_OF_LIGHT_M_PER_S
from geraf2.errors import UserError
from geraf2.io.manifest import RadarManifest

# The offset is estimated from as many neighbouring lines as these bytes of samples hold.
_SWEEP_BYTES, _MAX_SWEEPS = 1 << 26, 48
# An offset with a larger standard deviation is not determined.
_MAX_SIGMA_S = 2e-3


class RosbagImporter:
    """Reads frames and poses of ROS 2 bags."""

    def open(self, source: Path, radar: RadarManifest, options: ImportOptions = NO_OPTIONS) -> Scan:
        """Read the bag, estimate the layout and the clock offset; see Importer.open."""
        source = Path(source)
        if options.positions is not None or radar.raster is not None or options.static:
            what = "a bag holds its own poses"
            raise UserError(what=what, where=source, hint="leave out positions, raster and static")
        if not source.exists():
            raise UserError(what="no such file or folder", where=source)
        config = read_ti_configs(list(options.config) or find_ti_configs(source))
        bag = read_bag(source, options, radar.raw.frame_period_s or config.frame_period_s)
        recording = _recording(bag, source, radar, options)
        notes, offset = [], options.clock_offset_ms
        if offset is None:
            found = _find_offset(bag, recording, radar)
            text = f"{1e3 * found.offset_s:.2f} +- {1e3 * found.sigma_s:.2f} ms"
            text = f"radar {text} late, from {found.n_lines} lines"
            if found.sigma_s > _MAX_SIGMA_S:
                text, found = "not determined, taken as 0 ms", replace(found, offset_s=0.0)
                notes.append(
                    "the clock offset between radar and poses is not determined: that needs lines "
                    "in opposite directions; give --clock-offset-ms"
                )
            offset = 1e3 * found.offset_s
        else:
            text = f"radar {offset:g} ms late, given"
        clock = {"start_time_s": bag.start_s - 1e-3 * offset, "frame_period_s": bag.period_s}
        recording = replace(
            recording,
            missing_positions=bag.lost,
            notes=(*bag.notes, *recording.notes, *notes),
            facts=(*bag.facts, ("clock offset", text), *recording.facts),
        )
        radar = radar.model_copy(update={"raw": radar.raw.model_copy(update=clock)})
        return scan_of("rosbag", recording, radar, options, log=bag.log, period_s=bag.period_s)


def _recording(bag: Bag, source: Path, radar: RadarManifest, options: ImportOptions) -> Recording:
    """Open the frames as a recording, a message each."""
    options = replace(options, keep_good=True)  # compares the sizes itself
    recording = open_recording(source, radar, options, stream=bag.frames)
    chirp_bytes = recording.frame_bytes // recording.n_chirps_per_frame
    n_chirps, rest = divmod(bag.frame_bytes, chirp_bytes)
    is_given = radar.raw.n_chirps_per_frame or recording.config.n_chirps_per_frame
    if not rest and n_chirps != recording.n_chirps_per_frame and not is_given:
        raw = radar.raw.model_copy(update={"n_chirps_per_frame": n_chirps})
        radar = radar.model_copy(update={"raw": raw})
        return open_recording(source, radar, options, stream=bag.frames)
    if bag.frame_bytes != recording.frame_bytes:
        raise UserError(
            what="a message is not one frame",
            where=source,
            expected=f"{recording.frame_bytes} bytes: {recording.n_chirps_per_frame} chirps of "
            f"{recording.evidence.order.n_rx} receivers, {recording.evidence.n_samples} samples",
            got=f"{bag.frame_bytes} bytes",
            hint="correct --config, or n_chirps_per_frame and n_samples of --radar",
        )
    return recording


def _find_offset(bag: Bag, recording: Recording, radar: RadarManifest) -> ClockOffset:
    """Clock offset by the samples of the first transmitter on some lines in the middle."""
    log, config = bag.log, recording.config
    assert log.times_s is not None
    lines = straight_lines((float(log.times_s[0]), float(log.times_s[-1])), log.positions_at)
    sample_bytes = 8 * recording.evidence.order.n_rx * recording.evidence.n_samples
    delay_s = -0.5 * (radar.raw.chirp_s or 0.0) * (recording.n_tx - 1)
    lost, sweeps = np.array(bag.lost, dtype=int), []
    n_bytes = sum(b - a + 2 * MAX_OFFSET_S for a, b in lines) / bag.period_s * sample_bytes
    n_lines = min(_MAX_SWEEPS, int(len(lines) * min(1.0, _SWEEP_BYTES / max(n_bytes, 1))))
    first_line = (len(lines) - n_lines) // 2
    for begin, end in lines[first_line : first_line + n_lines]:
        ends = np.array([begin - MAX_OFFSET_S, end + MAX_OFFSET_S])
        first, stop = np.clip(
            np.ceil((ends - bag.start_s) / bag.period_s).astype(int), 0, recording.n_frames
        )
        if stop <= first:
            continue
        numbers = np.arange(first, stop)
        kept = ~np.isin(numbers, lost)
        signal = recording.read_frames(int(first), int(stop)).mean(axis=1)[kept, 0]
        times = bag.start_s + bag.period_s * numbers[kept] + delay_s
        sweeps.append(Sweep(interval_s=(begin, end), times_s=times, signal=signal))
    start_hz = radar.first_sample_hz() or config.first_sample_hz()
    slope = radar.chirp_slope_hz_per_s or config.chirp_slope_hz_per_s
    rate = radar.sample_rate_hz or config.sample_rate_hz
    if not (start_hz and slope and rate):  # reported with the waveform
        return ClockOffset(offset_s=0.0, sigma_s=np.inf, n_lines=0)
    n_samples = recording.evidence.n_samples
    sweep_s = n_samples * recording.evidence.order.per_complex / rate
    wavelength_m = SPEED_OF_LIGHT_M_PER_S / (start_hz + 0.5 * slope * sweep_s)
    return find_clock_offset(sweeps, log.positions_at, wavelength_m)
