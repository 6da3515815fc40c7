"""Verdict on a finished run: tests of the whole, the probability of a failure, and its cause.

Each test compares the run with a rival: another order or sense of the planes, another delay, a
surface that the planes do not confirm. The probability of a failure is logistic in their results
(docs/math/verdict.md).
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import expit

from geraf2.echoes import Glints
from geraf2.echoes.noise import normal_density
from geraf2.echoes.radius import modal_radius_m
from geraf2.errors import UserError
from geraf2.freespace.coverage import scan_coverage
from geraf2.io.mesh import TriangleMesh, read_mesh
from geraf2.io.run_folder import CONTENT_NAME, GLINTS_NAME
from geraf2.io.verdict import VERDICT_STAGE, Cause, Trust, Verdict
from geraf2.pipeline.box_check import BOX_STAGE
from geraf2.pipeline.plane_check import DOUBTFUL_SIGMAS, PlaneCheck, check_planes
from geraf2.pipeline.stages.calibration import CALIBRATION_STAGE
from geraf2.pipeline.stages.job import Job
from geraf2.scene.aperture import Aperture
from geraf2.scene.checks import MAX_SATURATED
from geraf2.scene.summary import saturation_share
from geraf2.surfaces.confirmation import Confirmation

# Log odds of a failure without evidence, and by each unit of it. Maximum likelihood of 90 scans of
# other objects than `bench/python/verdict_scans.py` has now, for which they hold: those that its
# scans give judge objects that were left out worse (log loss 0.66 against 0.46).
_LOG_ODDS = -4.94
_WEIGHTS: Mapping[str, float] = {
    "error": 3.21,
    "unseen": 2.53,
    "unconfirmed": 1.20,
    "disagreement": 1.59,
    "sense": 0.94,
    "delay": 0.44,
}
DOUBTFUL, FAILED = 0.15, 0.5
"""Probabilities of a failure from which a result is doubtful, and not to be trusted."""
_MIRRORED = 0.5
"""Probability that the horizontal axes of the rasters are reversed, not the turntable's sense."""
# Modal radii of sound content: a Gaussian, or anything up to a body of 13 cm, or seldom anything; a
# wrong delay moves them by up to a decimetre either way [m].
_RADIUS_M, _RADIUS_SIGMA_M, _ROUND_SHARE, _ROUND_M = 0.009, 0.006, 0.1, (-0.005, 0.065)
_DELAY_ERROR_M, _OTHER_SHARE = 0.1, 0.01
_USUAL_AGREEMENT = 0.3
_MIN_BLIND = 0.3
"""Least share of the content's height out of sight that is a cause."""
_SURE_NATS, _MAX_NATS, _SAME_DELAY_M = 3.0, 10.0, 0.04
"""Log odds from which the walls decide on the delay, and beyond which they count no more; and a
range cell of the two-way path [m]."""
_LOW_AGREEMENT = 0.1
"""Agreement of planes below which their geometry is a cause."""
_MAX_SIGMAS = 4.0
"""Larger evidence for the other sense of the turntable counts no more."""


@dataclass(frozen=True, kw_only=True)
class DelayByWalls:
    """What near and far walls say of the delay that was used."""

    odds: float = 0.0
    """Log odds of another delay against the recorded one; 0 where no far wall was seen."""
    other_m: float = 0.0
    """That delay, on the two-way path [m]."""
    used_m: float = 0.0
    """Delay of the run [m]."""

    @classmethod
    def of(cls, box: Mapping[str, Any], used_m: float) -> "DelayByWalls":
        """Read them from the numbers of the box."""
        odds, other = box.get("delay_odds", 0.0), box.get("other_delay_m", used_m)
        return cls(odds=float(odds), other_m=float(other), used_m=float(used_m))

    @property
    def is_wrong(self) -> bool:
        """Whether the walls fit another delay than the one that was used."""
        return self.odds > _SURE_NATS and abs(self.other_m - self.used_m) > _SAME_DELAY_M

    @property
    def is_right(self) -> bool:
        """Whether the walls confirm the delay that was used."""
        return abs(self.odds) > _SURE_NATS and not self.is_wrong


def judge(job: Job, *, is_turn_stated: bool = False) -> None:
    """Record the verdict on the run of a job; none for a preset without glints.

    is_turn_stated: whether the user stated that the turntable ran in the other sense.
    """
    if not (job.run.path / GLINTS_NAME).is_file():
        return
    with job.step(VERDICT_STAGE) as step:
        step.numbers |= RunTests.of(job, is_turn_stated=is_turn_stated).verdict().numbers()


@dataclass(frozen=True, kw_only=True, eq=False)
class RunTests:
    """Results of all tests of a run."""

    planes: PlaneCheck
    is_turned: bool
    """Whether the turntable's sense was corrected by the planes alone."""
    echoes: Confirmation
    radius_m: float | None
    """Most frequent radius of the content [m]; None where it is not seen."""
    walls: DelayByWalls
    error_m: float
    """Typical expected error [m]."""
    seen: float
    """Share of the surface that rests on an echo."""
    saturation: float
    plastic: float
    """Share of the strength of echoes from behind other ones."""
    mesh: TriangleMesh
    apertures: tuple[Aperture, ...]

    @classmethod
    def of(cls, job: Job, *, is_turn_stated: bool) -> "RunTests":
        """Do all tests of a job's run."""
        mesh = read_mesh(job.run.path / CONTENT_NAME)
        glints = Glints.load(job.run.path / GLINTS_NAME)
        stages = {name: record.numbers for name, record in job.run.stages.items()}
        apertures = tuple(Aperture.from_pose(pose) for pose in job.capture.poses)
        return cls(
            planes=check_planes(job.capture, job.peaks.of(job.capture)),
            is_turned=not is_turn_stated
            and bool(stages.get(CALIBRATION_STAGE, {}).get("reversed_turn", 0)),
            echoes=Confirmation.of(mesh, glints, apertures, num_threads=job.num_threads),
            radius_m=modal_radius_m(glints),
            walls=DelayByWalls.of(stages.get(BOX_STAGE, {}), job.capture.waveform.path_bias_m),
            error_m=1e-3 * stages["mesh"]["expected_error_median_mm"],
            seen=stages["mesh"]["evidence_shares"]["seen"],
            saturation=saturation_share(job.capture),
            plastic=stages["glints"].get("back_face_share", 0.0),
            mesh=mesh,
            apertures=apertures,
        )

    def evidence(self) -> dict[str, float]:
        """Results that the log odds are linear in; 0 where nothing is unusual."""
        known = bool(self.planes.recorded.n_pairs.any())
        agreement = max(self.planes.recorded.share, 1e-2) if known else _USUAL_AGREEMENT
        return {
            "error": float(np.log10(1e3 * self.error_m)),
            "unseen": -float(np.log10(max(self.seen, 0.02))),
            "unconfirmed": 1.0 - self.echoes.confirmed,
            "disagreement": max(0.0, -float(np.log10(agreement / _USUAL_AGREEMENT))),
            "sense": float(np.clip(self.planes.reversed_turn.sigmas, 0.0, _MAX_SIGMAS)),
            "delay": min(self.walls.odds, _MAX_NATS)
            if self.walls.is_wrong
            else delay_log_odds(self.radius_m),
        }

    def verdict(self) -> Verdict:
        """Return verdict, probability and causes."""
        evidence = self.evidence()
        weighed = {name: _WEIGHTS[name] * value for name, value in evidence.items()}
        probability = float(expit(_LOG_ODDS + sum(weighed.values())))
        if self.is_turned:
            probability = max(probability, _MIRRORED)
        trust = Trust.RELIABLE
        if probability >= DOUBTFUL:
            trust = Trust.DOUBTFUL if probability < FAILED else Trust.NOT_TO_BE_TRUSTED
        radius = None if self.radius_m is None else round(1e3 * self.radius_m, 1)
        tests = {name: round(value, 3) for name, value in evidence.items()}
        return Verdict(
            trust=trust,
            probability_of_failure=round(probability, 3),
            causes=() if trust == Trust.RELIABLE else tuple(self._causes(weighed)),
            tests={
                **self.planes.numbers(),
                "visible": round(self.echoes.visible, 3),
                "confirmed": round(self.echoes.confirmed, 3),
                "modal_radius_mm": radius,
                "saturation_share": self.saturation,
                "evidence": tests,
            },
        )

    def _causes(self, weighed: Mapping[str, float]) -> Iterator[Cause]:
        """Yield what explains a failure: what a test shows first, then what is low in general.

        weighed: what each result adds to the log odds, by which causes in the content are ordered.
        """
        yield from _of_planes(self.planes, is_turned=self.is_turned)
        if self.saturation > MAX_SATURATED:
            yield self._saturated()
        yield from sorted(
            (*self._of_content(), *self._of_coverage()),
            key=lambda cause: -weighed.get(cause.name, weighed["unseen"]),
        )
        yield from _disagreeing(self.planes)
        yield self._uncertain()

    def _of_content(self) -> Iterator[Cause]:
        """Yield a wrong delay and plastic, which leave the planes in agreement."""
        agrees = self.planes.recorded.share > _LOW_AGREEMENT
        is_odd = agrees and delay_log_odds(self.radius_m) > 0.0
        if self.walls.is_wrong:
            yield self._wrong_by_walls()
        elif is_odd and not self.walls.is_right and not self.plastic:
            yield self._delayed()
        if agrees and (self.plastic or (is_odd and self.walls.is_right)):
            yield self._plastic()

    def _of_coverage(self) -> Iterator[Cause]:
        """Yield what the planes cannot see: content out of their height, and few planes."""
        low, high = self.mesh.vertices.min(axis=0), self.mesh.vertices.max(axis=0)
        coverage = scan_coverage(self.apertures, 0.5 * (low + high), high - low)
        findings = coverage.findings()  # of blind heights first
        for one, finding in zip(coverage.blind, findings, strict=False):
            if one.span_m > _MIN_BLIND * (high[2] - low[2]):
                yield Cause("height", finding.message, finding.action)
        for finding in findings[len(coverage.blind) :]:
            yield Cause("few planes", finding.message, finding.action)

    def _uncertain(self) -> Cause:
        return Cause(
            "uncertain",
            f"{100.0 * self.seen:.0f} % of the surface rests on echoes, and of the echoes that it "
            f"should send back the planes received {100.0 * self.echoes.confirmed:.0f} %",
            "add planes, raised ones too (geraf2 plan), and look for noise, motion and errors of "
            "the hardware (geraf2 info)",
        )

    def _delayed(self) -> Cause:
        assert self.radius_m is not None
        off = 2e3 * (self.radius_m - _RADIUS_M)
        return Cause(
            "delay",
            f"the edges of the content have a radius of {1e3 * self.radius_m:z.0f} mm, as if the "
            f"instrument delay were {abs(off):.0f} mm too {'long' if off > 0 else 'short'}",
            "give the outside of the box with --box X Y Z, which determines the delay, or measure "
            "it: geraf2 calibrate",
        )

    def _saturated(self) -> Cause:
        return Cause(
            "saturated",
            f"{100.0 * self.saturation:.1f} % of a plane's samples are cut off at full scale",
            "lower the receiver's gain and scan again",
        )

    def _wrong_by_walls(self) -> Cause:
        return Cause(
            "delay",
            "near and far walls of the box agree with another instrument delay than the "
            f"{1e3 * self.walls.used_m:.0f} mm of path that were used",
            f"state path_bias_m = {self.walls.other_m:.3f} in scene.toml, or measure the delay: "
            "geraf2 calibrate",
        )

    def _plastic(self) -> Cause:
        seen = f"{100.0 * self.plastic:.0f} % of the echoes come from behind the surface"
        if not self.plastic:
            seen = "the echoes lie on surfaces that curve as no outside of a body does"
        return Cause(
            "plastic",
            f"{seen}: the content is plastic, and it is not certain which of its two faces sent "
            "each echo",
            "add planes from opposite sides (geraf2 plan), or use the content's position alone",
        )


def _of_planes(planes: PlaneCheck, *, is_turned: bool = False) -> Iterator[Cause]:
    if is_turned:
        yield Cause(
            "sense",
            "the planes agree only with the turntable in the other sense, which was taken; if "
            "the horizontal axes of the planes are reversed instead, this is the mirror image",
            "state --reverse-turn if the turntable ran the other way, else reverse the "
            "horizontal positions within each plane",
        )
    elif planes.reversed_turn.sigmas > DOUBTFUL_SIGMAS:
        yield Cause(
            "sense",
            "the planes agree better in the other sense of the turntable, or with the "
            "horizontal axes of the planes reversed",
            "reconstruct with --reverse-turn, or reverse the horizontal positions within "
            "each plane",
        )
    if planes.upside_down.sigmas > DOUBTFUL_SIGMAS:
        yield Cause(
            "axes",
            "the planes agree better with their vertical axes reversed",
            "reverse the vertical positions within each plane",
        )
    if planes.exchanged:
        pairs = ", ".join(f"{a} and {b}" for a, b in planes.exchanged)
        yield Cause(
            "swapped",
            f"planes agree with the others only in each other's places: {pairs}",
            "exchange their recordings, or leave these planes out",
        )


def _disagreeing(planes: PlaneCheck) -> Iterator[Cause]:
    if 0.0 < planes.recorded.share < _LOW_AGREEMENT:
        yield Cause(
            "planes",
            f"only {100.0 * planes.recorded.share:.0f} % of neighbouring echoes of different "
            "planes lie on a common surface; a sound scan has 20 to 60 %",
            "check the order of the planes, their angles, and the unit of their positions",
        )


def with_cause(error: UserError, planes: PlaneCheck) -> UserError:
    """Error of a run that ended before its surface, with what the planes show, if anything."""
    for cause in (*_of_planes(planes), *_disagreeing(planes)):
        return UserError(str(error), hint=f"{cause.text}: {cause.action}")
    return error


def delay_log_odds(radius_m: float | None) -> float:
    """Log odds of a wrong delay against a right one, by the content's modal radius [m]."""
    if radius_m is None:
        return 0.0
    low, high = _ROUND_M
    usual = (1.0 - _ROUND_SHARE) * normal_density(radius_m - _RADIUS_M, _RADIUS_SIGMA_M)
    usual += (_ROUND_SHARE if low <= radius_m <= high else _OTHER_SHARE) / (high - low)
    return float(np.log(1.0 / (2.0 * _DELAY_ERROR_M) / usual))
