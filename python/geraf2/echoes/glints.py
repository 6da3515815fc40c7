"""Search for glints: specular returns as oriented points.

A monostatic specular return comes from the point whose normal points at the antenna. Each peak of a
sub-aperture image therefore gives a position and a normal (docs/math/echoes.md#glints).
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from geraf2._bounds import Bounded, Decibels, Share, SignedDb, SignedM
from geraf2._types import Floats, Ints, Progress
from geraf2.echoes.flashes import learn_wall_delay
from geraf2.echoes.glint_set import Glints, relative_strengths
from geraf2.echoes.hypotheses import Candidates, find_candidates
from geraf2.echoes.labels import Clutter, Label, LabelledPeaks, label_peaks
from geraf2.echoes.noise import ECHO_NOISE, tangent_deviation
from geraf2.echoes.reflectivity import MetalLevel, Windows, metal_level
from geraf2.echoes.wall_faces import WallFaces
from geraf2.errors import UserError
from geraf2.imaging.peaks import DETECTION_DB, PeakSet, box_spans, collect_peaks
from geraf2.imaging.subapertures import SubapertureConfig
from geraf2.ops.visibility import MeshScene
from geraf2.scene import Capture, LosPrior
from geraf2.scene.aperture import Aperture

GLINTS_VERSION = 29
"""Increase when the same capture and settings give other glints."""

_MIN_GLINTS, _MIN_OF_FEW = 100, 0.15
"""Where fewer glints reach the least probability, the likeliest ones above the second value are
taken. By F1 of 21 random scans: twice as many add ghosts to five of them, and without the rule
three lose their surface."""


@dataclass(frozen=True, kw_only=True)
class GlintConfig(Bounded):
    """Selection of glints."""

    subaperture: SubapertureConfig = field(default_factory=SubapertureConfig)
    """Size and sampling of the images."""
    dynamic_range_db: Decibels = 22.0
    """Largest ratio of an image's strongest peak to a kept peak [dB]. Side lobes of the Hann window
    lie at -31 dB."""
    noise_margin_db: SignedDb = DETECTION_DB
    """Detection threshold relative to the noise of the range bin [dB]."""
    wall_margin_m: SignedM = 0.012
    """Half thickness of the layer around the prior's surface with the wall's own echoes [m]."""
    min_probability: Share = 0.5
    """Least probability of a direct return of the content."""
    range_correction_m: SignedM | None = None
    """Subtracted from every range of an echo from inside the box [m]; None: by the walls."""

    def for_planes(self, planes: Sequence[Aperture]) -> "GlintConfig":
        """Return the same with the sub-apertures of small planes."""
        return replace(self, subaperture=self.subaperture.for_planes(planes))


class FoundEchoes(NamedTuple):
    """Glints of a capture, and the labels of all peaks."""

    glints: Glints
    labelled: LabelledPeaks
    metal: MetalLevel | None
    """Strength of metal on the scale of the magnitudes; None where no wall shows it."""
    clutter: Clutter
    """What a return competes with."""
    peaks: PeakSet
    """All peaks at the ranges of the box."""

    def likelier_than(self, least: float) -> tuple[Glints, Ints]:
        """Glints of another least probability than the configured one.

        Their indices in the labelled peaks are the second value, (n_glints,).
        """
        return _likelier(self.peaks, self.labelled, least)


def find_glints(
    capture: Capture,
    prior: LosPrior,
    config: GlintConfig | None = None,
    *,
    peaks: PeakSet | None = None,
    num_threads: int | None = None,
    progress: Progress | None = None,
) -> Glints:
    """Glints of the content of the prior's box.

    Parameters
    ----------
    capture
        The scan.
    prior
        Outer surface of the box; its walls, or else the capture's, give the range correction.
    config
        Selection of glints.
    peaks
        Of the capture's planes; collected when None.
    num_threads
        When None, torch's number if torch is loaded, else all cores.
    progress
        Called with the fraction done.

    Returns
    -------
    Glints
        The oriented points, positions (n_glints, 3) [m].

    Raises
    ------
    UserError
        If no glint lies inside the box; the message states which echoes there are.

    Examples
    --------
    >>> capture, truth = geraf2.examples.small_capture()
    >>> glints = geraf2.find_glints(capture, geraf2.LosPrior.from_box(geraf2.examples.BOX_M))
    >>> glints.positions.shape == glints.normals.shape == (len(glints), 3)
    True
    """
    return find_echoes(
        capture,
        prior,
        config,
        peaks=peaks,
        num_threads=num_threads,
        progress=progress,
    ).glints


def find_echoes(
    capture: Capture,
    prior: LosPrior,
    config: GlintConfig | None = None,
    *,
    peaks: PeakSet | None = None,
    num_threads: int | None = None,
    progress: Progress | None = None,
) -> FoundEchoes:
    """Glints, and the label of every peak at the ranges of the box.

    Arguments and errors are those of `find_glints`.
    """
    apertures = [Aperture.from_pose(pose) for pose in capture.poses]
    config = (config or GlintConfig()).for_planes(apertures)
    if peaks is None:
        peaks = collect_peaks(
            capture,
            prior,
            config.subaperture,
            config.noise_margin_db,
            num_threads=num_threads,
            progress=progress,
        )
    near, found = candidates_around(capture, prior, peaks, config, num_threads=num_threads)
    if not (found.depth_m > config.wall_margin_m).any():
        raise _nothing_found(near, found, config)
    labelled = label_peaks(near, found, prior.expected_volume_m3, config.wall_margin_m)
    least = _threshold(labelled.probability, config.min_probability)
    if not (labelled.probability > least).any():
        n_scattered = int((labelled.labels == Label.CLUTTER).sum())
        raise _nothing_consistent(n_scattered)
    glints, _ = _likelier(near, labelled, least)
    metal = metal_level(
        near,
        Windows.of(
            apertures,
            near.planes,
            near.centers,
            prior,
            config.subaperture.size_m,
        ),
        WallFaces.of(prior),
        prior.walls or capture.walls,
        capture.waveform,
    )
    clutter = Clutter.of(near, found, labelled, prior.expected_volume_m3)
    return FoundEchoes(glints, labelled, metal, clutter, near)


def _likelier(peaks: PeakSet, labelled: LabelledPeaks, least: float) -> tuple[Glints, Ints]:
    index = np.flatnonzero(labelled.probability > least)
    probability = labelled.probability[index]
    return as_glints(peaks, labelled.candidates.select(index), probability), index


def _threshold(probability: Floats, least: float) -> float:
    """Least probability of a glint, lowered if few reach it."""
    likeliest = np.sort(probability)[-_MIN_GLINTS:]
    return float(np.clip(likeliest[0], min(_MIN_OF_FEW, least), least))


def candidates_around(
    capture: Capture,
    prior: LosPrior,
    peaks: PeakSet,
    config: GlintConfig,
    *,
    num_threads: int | None = None,
) -> tuple[PeakSet, Candidates]:
    """Peaks in the box's span of ranges and the dynamic range, and their candidates."""
    near = peaks.within(box_spans(capture.poses, prior))
    near = near.select(near.levels_db >= -config.dynamic_range_db)
    scene = MeshScene(prior.vertices, prior.faces, num_threads=num_threads)
    walls, correction_m = prior.walls or capture.walls, config.range_correction_m
    if correction_m is None and not walls:
        correction_m = learn_wall_delay(near, WallFaces.of(prior), capture.waveform)
    found = find_candidates(
        near,
        capture.poses,
        scene,
        walls,
        wall_margin_m=config.wall_margin_m,
        range_correction_m=correction_m,
    )
    return near, replace(found, presence=prior.presence(found.positions))


def as_glints(peaks: PeakSet, found: Candidates, probability: Floats) -> Glints:
    """Glints from candidates (n,), corrected for the bias of merged echoes, with uncertainties.

    peaks: of the candidates.
    probability: that each is a direct return of the content, (n,).
    """
    raw = peaks.select(found.peaks)
    deviation = tangent_deviation(found.positions, found.normals)
    relative = relative_strengths(raw.magnitudes)
    position_sigma_m, normal_sigma_rad = ECHO_NOISE.of_glints(deviation, relative)
    bias_m = ECHO_NOISE.bias_per_deviation * deviation
    return Glints(
        positions=found.positions - bias_m[:, None] * found.normals,
        normals=found.normals,
        strengths=raw.magnitudes,
        position_sigma_m=position_sigma_m,
        normal_sigma_rad=normal_sigma_rad,
        poses=raw.planes,
        probability=probability,
    )


def _nothing_found(peaks: PeakSet, found: Candidates, config: GlintConfig) -> UserError:
    if not len(peaks):
        seen = f"no echo {config.noise_margin_db:g} dB above the noise at the box's range"
    else:
        depth_m = found.depth_m[~found.is_alias]
        n_wall = int((np.abs(depth_m) <= config.wall_margin_m).sum())
        n_outside = int((depth_m < -config.wall_margin_m).sum())
        nearest = float(peaks.ranges_m.min())
        farthest = float(peaks.ranges_m.max())
        seen = (
            f"{n_wall} echoes of the box's walls and {n_outside} outside it, "
            f"at ranges from {nearest:.2f} to {farthest:.2f} m"
        )
    return UserError(
        "no glint inside the box",
        expected="echoes of the content",
        got=seen,
        hint="check that the box is in the scan's frame and in metres, the instrument delay "
        "path_bias_m, and that the box is not empty",
    )


def _nothing_consistent(n_points: int) -> UserError:
    return UserError(
        "no glint inside the box",
        expected="echoes that lie on one surface with their neighbours",
        got=f"{n_points} scattered echoes",
        hint="check the antenna positions, the frame and the instrument delay path_bias_m",
    )
