"""Heat map of the echo of reflecting points."""

from typing import Any

import numpy as np

from geraf2._types import Array
from geraf2._validation import require_shape
from geraf2.ops._matched_filter_native import Settings, make_problem, require_signal
from geraf2.ops._signal_tracer_native import make_tracer_problem
from geraf2.records import Waveform


class FacetEcho:
    """Heat map of reflecting points by a group of antennas: traced signals, then matched filter.

    Linear in the amplitudes: P(x) = sum_p K(x, p) a_p, K(x, p) = (1 / N) sum over antennas and
    samples of exp(2 pi j f (d_i(x) - d_i(p)) / c) (docs/math/signal-tracer.md). In single
    precision.

    tx, rx: transmitter and receiver of each antenna, (n_antennas, 3) [m].
    targets: where the heat map is taken, (n_targets, 3) [m].
    num_threads: threads; torch's number when torch is loaded, else all cores, when None. With one
        all results repeat bit for bit.
    """

    def __init__(
        self, tx: Any, rx: Any, targets: Any, waveform: Waveform, *, num_threads: int | None = None
    ) -> None:
        self._waveform, self._num_threads = waveform, num_threads
        # Isolated targets are summed one by one; grouping them costs more.
        settings = Settings("exact", num_threads=num_threads)
        self._filter = make_problem(tx, rx, targets, waveform, settings)

    def matched(self, signal: Array) -> Array:
        """Heat map of a signal complex64 (n_antennas, n_samples) at the targets, (n_targets,)."""
        require_signal(signal, self._filter)
        return self._filter.image(signal)

    def image(self, amplitudes: Array, points: Any) -> Array:
        """Heat map of points (n_points, 3) [m] with real amplitudes (n_points,)."""
        tracer = make_tracer_problem(
            points,
            self._filter.tx,
            self._filter.rx,
            self._waveform,
            rtol=1e-3,
            num_threads=self._num_threads,
        )
        require_shape("amplitudes", amplitudes, (len(tracer.points),))
        return self._filter.image(tracer.signal(amplitudes.astype(np.float32), None))
