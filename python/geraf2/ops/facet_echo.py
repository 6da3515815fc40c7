"""Heat map of the echo of reflecting points, and the adjoint."""

from typing import Any

import numpy as np

from geraf2._types import Array, Floats
from geraf2._validation import require_shape
from geraf2.ops._matched_filter_native import Settings, make_problem, require_signal
from geraf2.ops._signal_tracer_native import TracerProblem, make_tracer_problem
from geraf2.records import Waveform


class FacetEcho:
    """Heat map of reflecting points by a group of antennas: traced signals, then matched filter.

    Linear in the amplitudes: P(x) = sum_p K(x, p) a_p, K(x, p) = (1 / N) sum over antennas and
    samples of exp(2 pi j f (d_i(x) - d_i(p)) / c) (docs/math/signal-tracer.md). In single
    precision.

    tx, rx: transmitter and receiver of each antenna, (n_antennas, 3) [m].
    targets: where the heat map is taken, (n_targets, 3) [m].
    waveform: the chirp.
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
        self._middles = self._filter.tx.mean(axis=0), self._filter.rx.mean(axis=0)
        self.targets: Floats = np.asarray(targets, dtype=np.float64)
        """(n_targets, 3) [m]."""

    @property
    def antennas(self) -> tuple[Floats, Floats]:
        """Transmitters and receivers, (n_antennas, 3) [m] each."""
        return self._filter.tx, self._filter.rx

    def matched(self, signal: Array) -> Array:
        """Heat map of a signal complex64 (n_antennas, n_samples) at the targets, (n_targets,)."""
        require_signal(signal, self._filter)
        return self._filter.image(signal)

    def image(self, amplitudes: Array, points: Any) -> Array:
        """Heat map of points (n_points, 3) [m] with real amplitudes (n_points,)."""
        tracer = self._tracer(points)
        require_shape("amplitudes", amplitudes, (len(tracer.points),))
        return self._filter.image(tracer.signal(amplitudes.astype(np.float32), None))

    def adjoint(self, image: Array, points: Any) -> Array:
        """K^H of a complex64 image (n_targets,), at points (n_points, 3) [m]: (n_points,)."""
        require_shape("image", image, (len(self.targets),))
        tracer = self._tracer(points)
        found = tracer.gradients(
            self._filter.adjoint(image.astype(np.complex64)),
            np.zeros(len(tracer.points), dtype=np.complex64),
            None,
            want_amplitude=True,
            want_normals=False,
            want_points=False,
            want_antennas=False,
        )
        back: Array = found.amplitude
        return back

    def path_gradient(self, points: Floats) -> Floats:
        """Gradient of the two-way path from the antennas' middle to points (n_points, 3) [m]."""
        total = np.zeros(points.shape)
        for middle in self._middles:
            leg = points - middle
            total += leg / np.linalg.norm(leg, axis=1, keepdims=True)
        return total

    def _tracer(self, points: Any) -> TracerProblem:
        tx, rx = self.antennas
        threads = self._num_threads
        return make_tracer_problem(points, tx, rx, self._waveform, rtol=1e-3, num_threads=threads)
