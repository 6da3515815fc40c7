"""Smallest ball that would have been found at a place (docs/math/echoes.md#detectability).

A ball of radius a returns an echo to every antenna that sees it, of the amplitude of metal times
a / (2 R^2). That stands out where it exceeds whatever hides an echo at its place: the noise, the
dynamic range of the image, and the main lobes of stronger echoes. It is found where it stands out
in so many sub-apertures that the labels take its returns for content, against the scan's clutter.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from geraf2._types import Bools, Floats, Ints
from geraf2.echoes.glints import GlintConfig
from geraf2.echoes.labels import Clutter
from geraf2.echoes.reflectivity import crossing_loss, mid_wave_number
from geraf2.imaging.peaks import PeakSet, box_spans
from geraf2.ops.visibility import MeshScene
from geraf2.records import Wall
from geraf2.scene import Capture, LosPrior
from geraf2.scene.aperture import Aperture

_CELLS = np.linspace(0.0, 4.0, 161)
"""Offsets at which the response of a window is tabulated, in cells of one over its length."""
LEAST_RADIUS_M = 0.0012
"""Smaller balls, below a third of a wavelength, return less than geometrical optics has it [m]."""


_OWN_SHARE, _OTHER_SHARE = 0.2, 0.15
"""Support by a return of the same ball in the same plane and in another one, over that at the same
place with the same normal: normals of a ball turn from sub-aperture to sub-aperture."""
_MARGIN = 2.2
"""Radius that is found 19 times of 20, over that with which the labels are even. These three were
chosen on scans of random radii (`bench/python/detectability.py --fit`)."""
_RADII_M = np.geomspace(0.0004, 0.04, 70)
"""Radii that are tried [m]."""


def hann_response(cells: Floats) -> Floats:
    """Response of a Hann window over its peak, |sinc(x) / (1 - x^2)|.

    cells: offset x in cells of one over the window's length, any shape.
    """
    x = np.where(np.abs(np.abs(cells) - 1.0) < 1e-6, 1.0 - 1e-6, cells)
    return np.asarray(np.abs(np.sinc(x) / (1.0 - x**2)))


_RESPONSE = hann_response(_CELLS)


@dataclass(frozen=True, kw_only=True, eq=False)
class Detector:
    """What hides a small body in the images of a scan."""

    peaks: PeakSet
    """At the ranges of the box."""
    apertures: Sequence[Aperture]
    """Of all planes of the scan."""
    walls: Sequence[Wall]
    """That an echo crosses."""
    wave_number: float
    """At mid-band [rad/m]."""
    range_cell_m: float
    """c / 2B [m]."""
    focus_m: Floats
    """Point on which images are focused, (3,) [m]."""
    config: GlintConfig
    """Thresholds of the search for glints."""
    strength_m: float
    """Of metal, :class:`geraf2.echoes.reflectivity.MetalLevel` [m]."""
    clutter: Clutter
    """What its returns compete with."""

    @classmethod
    def of(
        cls,
        capture: Capture,
        prior: LosPrior,
        peaks: PeakSet,
        config: GlintConfig,
        strength_m: float,
        clutter: Clutter,
    ) -> "Detector":
        """Detector of a scan, from all of its peaks."""
        return cls(
            peaks=peaks.within(box_spans(capture.poses, prior)),
            apertures=[Aperture.from_pose(pose) for pose in capture.poses],
            walls=prior.walls or capture.walls,
            wave_number=mid_wave_number(capture.waveform),
            range_cell_m=capture.waveform.range_cell_m,
            focus_m=prior.bounds.mean(axis=0),
            config=config,
            strength_m=strength_m,
            clutter=clutter,
        )

    def smallest_radii(self, points: Floats, blocker: MeshScene | None = None) -> Floats:
        """Least radius with which a ball is found, (n,) [m]; inf where it is out of sight.

        Arguments as those of `needed_radii`.
        """
        planes = self.needed_radii(points, blocker)
        if not planes:
            return np.full(len(points), np.inf)
        share = len(self.peaks.tops) / max(int(self._spaced().sum()), 1)
        # Sub-apertures in which a ball of each radius stands out, (n_points, n_planes, n_radii).
        counts = share * np.stack(
            [(one[:, :, None] <= _RADII_M).sum(axis=1) for one in planes], axis=1
        )
        away = np.median(
            [np.linalg.norm(points - plane.middle_m, axis=1) for plane in self.apertures], axis=0
        )
        metal = self.strength_m * crossing_loss(self.walls)
        level = metal * _RADII_M / (2.0 * away[:, None, None] ** 2)
        others = counts.sum(axis=1, keepdims=True) - counts
        odds = self.clutter.log_odds(
            _OWN_SHARE * np.maximum(counts - 1.0, 0.0), _OTHER_SHARE * others, level
        )
        found: Bools = np.any((odds > 0.0) & (counts > 0.0), axis=1)
        least = np.where(found.any(axis=1), _RADII_M[found.argmax(axis=1)], np.inf)
        return np.asarray(np.maximum(_MARGIN * least, LEAST_RADIUS_M))

    def needed_radii(self, points: Floats, blocker: MeshScene | None = None) -> list[Floats]:
        """Least radius with which a ball stands out in each sub-aperture, (n, m) [m] a plane.

        points: centres of balls, (n, 3) [m]. blocker: what hides them; nothing when None.

        inf where the ball is out of sight, or out of the image.
        """
        kept = self._spaced()
        found = []
        for number in range(len(self.apertures)):
            own = np.flatnonzero((self.peaks.subaperture_planes == number) & kept)
            if len(own):
                found.append(self._of_plane(points, number, own, blocker))
        return found

    def _spaced(self) -> Bools:
        """Whether each sub-aperture is one of those half a side apart, (n_subapertures,)."""
        return self.peaks.spaced(0.5 * self.config.subaperture.size_m)

    def _of_plane(
        self, points: Floats, number: int, own: Ints, blocker: MeshScene | None
    ) -> Floats:
        plane, peaks = self.apertures[number], self.peaks
        centers = peaks.subaperture_centers[own]
        lines = points[:, None] - centers[None]
        away = np.linalg.norm(lines, axis=2)
        ahead, u, v = np.moveaxis(lines @ plane.axes.T, 2, 0) / away
        sides = np.minimum(2.0 * plane.half_m, self.config.subaperture.size_m)
        focus = np.abs((self.focus_m - centers) @ plane.axes[0])
        defocus = self.wave_number * (1.0 / focus[None] - 1.0 / away)
        gain = _focus_gain(defocus * sides[0] ** 2) * _focus_gain(defocus * sides[1] ** 2)
        metal = self.strength_m * crossing_loss(self.walls) * gain
        hidden = self._thresholds(number, own, away, np.stack([u, v], axis=-1), sides)
        needed = 2.0 * away**2 * hidden / metal
        largest = self.config.subaperture.max_cosine
        out = (ahead <= 0.0) | (np.abs(u) > largest) | (np.abs(v) > largest)
        if blocker is not None:
            start = np.broadcast_to(centers[None], lines.shape).reshape(-1, 3)
            end = np.broadcast_to(points[:, None], lines.shape).reshape(-1, 3)
            out |= blocker.occluded(start, end).reshape(out.shape)
        return np.asarray(np.where(out, np.inf, needed))

    def _thresholds(
        self, number: int, own: Ints, away: Floats, cosines: Floats, sides: Floats
    ) -> Floats:
        """Amplitude below which an echo is hidden in each sub-aperture of a plane, (n, m)."""
        peaks, config = self.peaks, self.config
        of_plane = peaks.planes == number
        noise = _noise_at(peaks.ranges_m[of_plane], peaks.noise[of_plane], self.range_cell_m, away)
        weakest = 10.0 ** (-config.dynamic_range_db / 20.0) * peaks.tops[own]
        hidden = np.maximum(10.0 ** (config.noise_margin_db / 20.0) * noise, weakest)
        along = peaks.directions @ self.apertures[number].axes[1:].T
        order = np.argsort(peaks.subapertures, kind="stable")
        first = np.searchsorted(peaks.subapertures[order], np.arange(len(peaks.tops) + 1))
        # Of a window of side L the two-way cell of a direction cosine is wavelength / 2 L.
        cells = np.array([self.range_cell_m, *(np.pi / (self.wave_number * sides))])
        for column, number_of_sub in enumerate(own):
            here = order[first[number_of_sub] : first[number_of_sub + 1]]
            here = here[peaks.magnitudes[here] > weakest[column]]
            off = cosines[:, None, column] - along[None, here]
            off = _unwrapped(off, peaks.periods[number_of_sub])
            deep = away[:, None, column] - peaks.ranges_m[None, here]
            lobes = _lobe(np.concatenate([deep[..., None], off], axis=2) / cells)
            masked = (peaks.magnitudes[here] * lobes.prod(axis=2)).max(axis=1, initial=0.0)
            hidden[:, column] = np.maximum(hidden[:, column], masked)
        return np.asarray(hidden)


def _lobe(cells: Floats) -> Floats:
    return np.asarray(np.interp(np.abs(cells), _CELLS, _RESPONSE, right=0.0))


def _unwrapped(off: Floats, periods: Floats) -> Floats:
    """Differences of direction cosines, (..., 2), less the nearest multiple of their periods."""
    period = np.where(np.isfinite(periods), periods, 1e9)
    return np.asarray(off - period * np.rint(off / period))


_BENDS = np.linspace(0.0, 60.0, 121)


def _focus_gain(bend: Floats) -> Floats:
    """Share of the amplitude that a Hann window of one side keeps at a quadratic phase.

    bend: phase k side^2 (1 / F - 1 / R), of which a fourth is met at the window's ends [rad].
    """
    steps = (np.arange(33) + 0.5) / 33 - 0.5
    hann = np.cos(np.pi * steps) ** 2
    table = np.abs(np.exp(1j * _BENDS[:, None] * steps**2) @ hann) / hann.sum()
    return np.asarray(np.interp(np.abs(bend), _BENDS, table))


def _noise_at(ranges_m: Floats, noise: Floats, cell_m: float, away: Floats) -> Floats:
    """Noise of a plane's images at ranges, from that of the range bins of its peaks, as `away`."""
    if not len(noise):
        return np.full(away.shape, np.inf)
    bins, at = np.unique(np.rint(2.0 * ranges_m / cell_m), return_inverse=True)
    medians = np.array([np.median(noise[at == k]) for k in range(len(bins))])
    return np.asarray(np.interp(away, 0.5 * cell_m * bins, medians))
