"""A reconstruction that grows with its scan, plane by plane."""

import hashlib
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from shutil import rmtree
from tempfile import TemporaryFile
from types import TracebackType
from typing import TYPE_CHECKING, Self
from weakref import finalize

import numpy as np

from geraf2._types import Array, Floats
from geraf2.apps.live.target import Target
from geraf2.calibration.corrections import Corrections
from geraf2.errors import UserError
from geraf2.io.growing_scene import GrowingScene
from geraf2.io.outputs import require_folder
from geraf2.io.pose_digest import PoseDigest
from geraf2.io.run_folder import (
    CALIBRATION_NAME,
    CONFIG_NAME,
    RUN_NAME,
    RunFolder,
    link_file,
)
from geraf2.pipeline.box_check import BOX_STAGE, BoxCheck
from geraf2.pipeline.commands.reconstruct import (
    Request,
    keep_inputs,
    log_run,
    make_surface,
    run_request,
    start_job,
    temporary_folder,
)
from geraf2.pipeline.events import Listener
from geraf2.pipeline.presets import BestPreset, FastPreset, PresetConfig, preset_type
from geraf2.pipeline.prior import PriorSource
from geraf2.pipeline.reconstruction import Reconstruction
from geraf2.pipeline.run_log import RunListener
from geraf2.pipeline.run_record import RunOptions, RunRecord
from geraf2.pipeline.stages.calibration import CALIBRATION_STAGE, calibrate_job
from geraf2.pipeline.stages.job import Job
from geraf2.scene import Capture, LosPrior, Pose, Waveform
from geraf2.scene.aperture import Aperture
from geraf2.scene.checks import require_plausible
from geraf2.scene.store import capture_digest, manifest_of, open_capture
from geraf2.scene.summary import (
    CaptureSummary,
    PoseSummary,
    is_delay_given,
    summarize_pose,
)

if TYPE_CHECKING:
    from geraf2.imaging.peaks import KeptPeaks

SCENE_FOLDER = "scene"
"""Folder of the planes in that of the session."""
# Box and calibration are estimated again once the scan has this many times the planes.
_GROWTH = 1.25
# Largest change of the box that leaves the peaks as they are until the end [m]: a fifth of the
# margin around the box within which they are collected.
_SAME_BOX_M = 0.01
# Steps whose results further planes use.
_SETTLED = (BOX_STAGE, CALIBRATION_STAGE)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Estimate:
    """Box and corrections of the planes so far, which further planes use."""

    n_planes: int
    box: BoxCheck | None
    corrections: Corrections
    job: Job
    prior_name: str


class Session:
    """A scan in progress: planes are added, and a result is there at any moment.

    Samples are kept on disk; peaks, a thousandth of them, in memory. Lengths are in metres.

    Parameters
    ----------
    scan
        The radar's waveform; or a capture with its waveform, walls, frame and provenance, whose
        planes are added.
    prior, preset, options
        As of `geraf2.reconstruct`; no plane can be left out.
    out
        Run folder, whose folder `scene` keeps the planes. A session that is there continues, also
        after its process was killed. None: a temporary folder, removed with the session.
    num_threads
        Threads of the kernels; all when None.
    listener
        Receives warnings and progress.

    Raises
    ------
    UserError
        If `out` holds something else or a session of another radar, another process writes into
        it, or the preset states no errors.

    Examples
    --------
    >>> capture, truth = geraf2.examples.small_capture()
    >>> with geraf2.Session(capture.waveform, geraf2.examples.BOX_M, "fast") as session:
    ...     for pose in capture.poses:
    ...         session.add(pose)
    ...     len(session), session.reaches("expected 0.1 mm over 90 %")
    (6, False)
    """

    def __init__(
        self,
        scan: Waveform | Capture,
        prior: LosPrior | PriorSource | Path | str | tuple[float, float, float] | None = None,
        preset: PresetConfig | str = "best",
        out: Path | str | None = None,
        *,
        options: RunOptions | None = None,
        num_threads: int | None = None,
        listener: Listener | None = None,
    ) -> None:
        options = options or RunOptions()
        if options.hold_out:
            raise UserError(what="a session leaves no plane out", got=f"{options.hold_out}")
        config = preset_type(preset)() if isinstance(preset, str) else preset
        if not isinstance(config, FastPreset | BestPreset):
            raise UserError(
                what=f"preset {config.preset!r} is too slow to follow a scan, or states no errors",
                expected="best or fast",
            )
        self._listener, self._threads = listener or Listener(), num_threads
        about = scan if isinstance(scan, Capture) else Capture(waveform=scan, poses=())
        self.path = temporary_folder() if out is None else Path(out)
        """Run folder."""
        self._given = prior if isinstance(prior, LosPrior) else None
        self._record = RunRecord(
            scene=self.path / SCENE_FOLDER,
            prior=PriorSource.from_argument(prior),
            options=options,
            config=config,
        )
        _require_readable(self._record.prior, self._listener)
        self._open = ExitStack()
        self._run = _open_run(self.path, replace(about, poses=()))
        self._open.enter_context(self._run.lock())
        self._close = finalize(self, self._open.close)
        if out is None:
            finalize(self, rmtree, self.path, ignore_errors=True)
        self._scene = GrowingScene(self.path / SCENE_FOLDER, manifest_of(replace(about, poses=())))
        self._poses: list[Pose] = []
        self._summaries: list[PoseSummary] = []
        self._digest, self._known = PoseDigest(), dict[str, int]()
        self._last_s = -np.inf
        self._peaks: KeptPeaks | None = None
        self._estimate: _Estimate | None = None
        self._result: Reconstruction | None = None
        self._about = replace(about, poses=())
        if len(self._scene):
            stored = open_capture(self._scene.path)
            self._about = replace(stored, poses=())
            for pose in stored.poses:
                self._take(pose, summarize_pose(pose))
        for pose in about.poses:
            self.add(pose)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def __len__(self) -> int:
        """Return the number of planes."""
        return len(self._poses)

    def __repr__(self) -> str:
        return f"Session({str(self.path)!r}, {len(self)} planes)"

    def __contains__(self, pose: Pose) -> bool:
        """Whether these samples were added."""
        return digest_samples(pose) in self._known

    @property
    def digests(self) -> frozenset[str]:
        """Hash of the samples of each plane."""
        return frozenset(self._known)

    @property
    def capture(self) -> Capture:
        """Planes so far, uncorrected; their samples are read from disk when used."""
        return replace(self._about, poses=tuple(self._poses))

    @property
    def run(self) -> RunFolder:
        """Record of the run."""
        return self._run

    def add(self, pose: Pose, *, times_s: Floats | None = None) -> None:
        """Add a plane; it is on disk when this returns.

        A plane older than the one before it is a warning.

        Parameters
        ----------
        pose
            Samples (n_antennas, n_samples), positions (n_antennas, 3) [m] and axes (3, 3).
        times_s
            Times of its antennas, (n_antennas,) [s].

        Raises
        ------
        UserError
            For a plane that was added before, has another number of samples, implausible values,
            or times that go back. The session does not change.
        """
        name = f"plane {pose.name or len(self)}"
        wanted, got = self._about.waveform.n_samples, pose.signal.shape[1]
        if got != wanted:
            raise UserError(
                what="is of another radar", where=name, expected=f"{wanted} samples", got=got
            )
        if pose in self:
            before = self._known[digest_samples(pose)]
            raise UserError(what=f"is plane {before} again: it was left out", where=name)
        summary = summarize_pose(pose)
        require_plausible(self._summary([summary]), name)
        self._check_times(times_s, pose, name)
        self._scene.append(pose)
        self._take(pose, summary)

    @property
    def result(self) -> Reconstruction:
        """Reconstruction of the planes so far, updated when planes were added.

        Box and calibration are estimated from a part of the planes, without slow errors of
        positions; `finish` estimates them from all.

        Raises
        ------
        UserError
            As long as there is no surface.
        """
        if self._result is None:
            self._require_planes()
            self._update()
            self._result = Reconstruction(self._run)
        return self._result

    def reaches(self, target: Target | str) -> bool:
        """Whether the surface is reliable and expected to be as good as this.

        Parameters
        ----------
        target
            "expected 1 mm over 90 %": an expected error of at most 1 mm on 90 % of the area.

        Returns
        -------
        bool
            False also as long as there is no surface, or its verdict is not `reliable`.

        Raises
        ------
        UserError
            For a text of another form.
        """
        wanted = Target.of(target)
        try:
            result = self.result
        except UserError:
            return False
        return wanted.is_met(result)

    def finish(self, *, report: bool = False) -> Reconstruction:
        """Reconstruct the whole scan, as `geraf2.reconstruct` does of the folder `scene`.

        Planes can still be added afterwards.

        Parameters
        ----------
        report
            Also write `report.html`.

        Returns
        -------
        Reconstruction
            The result, whose folder is `path`.

        Raises
        ------
        UserError
            Without planes, or if they give no surface.
        """
        self._require_planes()
        self._run.scene_digest = self._scene_digest()
        with self._run.replace_whole(grows=True) as new:
            run_request(self._request(), new, peaks=self._peaks, report=report)
        self._estimate = None
        self._result = Reconstruction(self._run)
        return self._result

    def close(self) -> None:
        """Let other processes write into the folder; the session can be opened again."""
        self._close()

    @property
    def n_imaged(self) -> int:
        """Images of planes so far; one for each if the box did not change."""
        return 0 if self._peaks is None else self._peaks.n_imaged

    @property
    def n_peaks(self) -> int:
        """Number of peaks of the last plane, once a result was asked for."""
        if self._peaks is None or not self._poses:
            return 0
        capture = self.capture if self._estimate is None else self._estimate.job.capture
        return len(self._peaks.of(capture, [len(capture.poses) - 1]))

    def _require_planes(self) -> None:
        if not self._poses:
            raise UserError(what="the session has no plane yet", where=self.path)

    def _check_times(self, times_s: Floats | None, pose: Pose, name: str) -> None:
        if times_s is None:
            return
        times = np.asarray(times_s, dtype=np.float64)
        if times.shape != (pose.n_antennas,) or not np.isfinite(times).all():
            expected = f"{pose.n_antennas} finite times, one for each antenna"
            raise UserError(what="has other times", where=name, expected=expected, got=times.shape)
        if (np.diff(times) < 0.0).any():
            raise UserError(what="has times that go back", where=name)
        if len(times) and times[0] < self._last_s:
            self._listener.warning(f"{name} is {self._last_s - times[0]:.1f} s older than the last")
        self._last_s = max(self._last_s, float(times.max(initial=-np.inf)))

    def _summary(self, poses: Sequence[PoseSummary]) -> CaptureSummary:
        about = self._about
        return CaptureSummary(
            waveform=about.waveform,
            walls=about.walls,
            poses=tuple(poses),
            delay_given=is_delay_given(about),
        )

    def _take(self, pose: Pose, summary: PoseSummary) -> None:
        self._summaries.append(summary)
        self._known[digest_samples(pose)] = len(self)
        self._digest.add(pose)
        self._poses.append(replace(pose, signal=_map_to_disk(pose.signal, self.path)))
        self._result = None

    def _scene_digest(self) -> str:
        return capture_digest(self._about, self._digest)

    def _request(self) -> Request:
        return Request.check(
            self.capture,
            self._given,
            self._record,
            self._listener,
            self._threads,
            self._summary(self._summaries),
        )

    def _update(self) -> None:
        estimate = self._estimate
        self._run.scene_digest = self._scene_digest()
        self._estimate = None  # until the surface is there
        if estimate is None or len(self) >= _GROWTH * estimate.n_planes:
            self._estimate = self._estimate_all()
        else:
            self._estimate = self._extend(estimate)

    def _estimate_all(self) -> _Estimate:
        """Surface with box and corrections estimated from all planes so far."""
        request, options = self._request(), self._record.options
        corrections = Corrections()
        with self._run.replace_whole(grows=True) as new, log_run(new, resume=False):
            job, name = start_job(request, new, peaks=self._peaks, tolerance_m=_SAME_BOX_M)
            self._peaks = job.peaks
            if options.calibrate == "auto":
                job, corrections = calibrate_job(
                    job, with_positions=False, before=request.corrections
                )
            job = replace(job, capture=self._spool(job.capture, ()), is_growing=True)
            keep_inputs(job, request.summary.planes)
            make_surface(job, name, options)
        return _Estimate(
            n_planes=len(self),
            box=request.box,
            corrections=corrections,
            job=job,
            prior_name=name,
        )

    def _extend(self, estimate: _Estimate) -> _Estimate:
        """Surface with box and corrections that are known."""
        capture = self.capture if estimate.box is None else estimate.box.place(self.capture)
        digest, before = self._run.scene_digest, estimate.job.run
        poses = self._spool(estimate.corrections.applied(capture), estimate.job.capture.poses)
        with self._run.replace_whole(grows=True) as new, log_run(new, resume=False):
            new.asked |= before.asked
            new.stages |= {n: before.stages[n] for n in _SETTLED if n in before.stages}
            for name in (CONFIG_NAME, CALIBRATION_NAME):
                if self._run.find_file(name) is not None:
                    link_file(self.path / name, new.path / name)
            job = replace(
                estimate.job,
                run=new,
                listener=RunListener(new, self._listener),
                capture=poses,
                inputs={**estimate.job.inputs, "scene": digest},
                made_from={**estimate.job.made_from, "scene": digest},
            )
            keep_inputs(job, [Aperture.from_pose(pose) for pose in job.capture.poses])
            make_surface(job, estimate.prior_name, replace(self._record.options, trust_los=True))
        return replace(estimate, job=job)

    def _spool(self, capture: Capture, before: Sequence[Pose]) -> Capture:
        """Corrected capture, whose samples are on disk and whose first poses are those before."""
        poses = [*before]
        for pose, own in zip(capture.poses[len(poses) :], self._poses[len(poses) :], strict=True):
            is_own = pose.signal is own.signal
            poses.append(
                pose if is_own else replace(pose, signal=_map_to_disk(pose.signal, self.path))
            )
        return replace(capture, poses=tuple(poses))


def _open_run(path: Path, about: Capture) -> RunFolder:
    """Record of a session's folder, new or to be continued."""
    digest, is_session = capture_digest(about), (path / SCENE_FOLDER).is_dir()
    if is_session and (path / RUN_NAME).is_file():
        return RunFolder.read(path)
    if (path / RUN_NAME).is_file():
        raise UserError(
            what="holds a run that is no session", where=path, hint="choose another folder"
        )
    require_folder(path, "run", own=is_session)
    path.mkdir(parents=True, exist_ok=True)
    return RunFolder(path, digest, SCENE_FOLDER)


def _require_readable(source: PriorSource, listener: Listener) -> None:
    """Raise UserError for a prior that no plane would make usable; photos are read with a scan."""
    if source.is_given and (source.los is None or not source.los.is_dir()):
        source.load((), listener)


def digest_samples(pose: Pose) -> str:
    """Hash of the samples of a plane."""
    return hashlib.sha256(np.ascontiguousarray(pose.signal).data).hexdigest()


def _map_to_disk(array: Array, folder: Path) -> Array:
    """Array in an unnamed file, which the system may drop from memory at any time."""
    with TemporaryFile(dir=folder) as file:
        file.write(np.ascontiguousarray(array).data)
        file.flush()
        return np.asarray(np.memmap(file, dtype=array.dtype, mode="c", shape=array.shape))
