"""Reconstruction of a scan that grows, until its scan is whole or good enough."""

import re
import time
from collections.abc import Callable, Iterable
from contextlib import ExitStack, closing
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Self

from geraf2.apps.importers import RecordingOptions
from geraf2.apps.live.opening import open_source
from geraf2.apps.live.session import Session, digest_samples
from geraf2.apps.live.sources import NewPlane, Source
from geraf2.apps.live.target import Target
from geraf2.errors import UserError
from geraf2.io.manifest import RadarManifest
from geraf2.io.verdict import Verdict
from geraf2.pipeline.events import Listener
from geraf2.pipeline.presets import PresetConfig
from geraf2.pipeline.prior import PriorSource
from geraf2.pipeline.reconstruction import Reconstruction
from geraf2.scene import Capture
from geraf2.scene.checks import Finding

PLANE_EVENT = "plane"
"""Event of log.jsonl for each plane."""
_POLL_S = 0.2
_NUMBERS = re.compile(r"[\d.]+")


@dataclass(frozen=True, kw_only=True)
class PlaneReport:
    """The surface after a plane."""

    plane: int
    """Number of planes so far."""
    name: str
    """Of the plane in its source."""
    seconds: float = 0.0
    """From the plane to the surface [s]."""
    n_peaks: int = 0
    """Peaks of the plane."""
    expected_error_mm: float | None = None
    """Not exceeded on half of the area [mm]; None without a surface."""
    seen_share: float | None = None
    """Share of the area that an echo came from."""
    stated_f1: tuple[float, float, float] | None = None
    """F1 at 5 mm, lower end of the 90 % interval, median, upper end; None where not determined."""
    verdict: Verdict | None = None
    """How far the surface can be trusted; None where it was not judged. The expected error of one
    that is not to be trusted is None."""
    problem: str = ""
    """Why the plane was left out, or there is no surface yet."""
    is_left_out: bool = False


@dataclass(frozen=True, kw_only=True)
class LiveOptions:
    """How a scan that grows is read, and when it is over."""

    radar: RadarManifest | None = None
    """Parameters that a recording lacks."""
    recording: RecordingOptions | None = None
    """Positions, topics and clock of a recording."""
    until: Target | None = None
    """End when the surface is expected to be as good."""
    idle_s: float = 60.0
    """End when no plane came for this time [s]."""
    report: bool = True
    """Write the report at the end."""


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """Result of a scan that was followed."""

    result: Reconstruction
    n_planes: int
    reason: str
    """Why it ended."""


def follow(
    source: Path | str,
    out: Path,
    prior: PriorSource,
    preset: PresetConfig | str = "best",
    *,
    ending: LiveOptions | None = None,
    listener: Listener | None = None,
    on_plane: Callable[[PlaneReport], None] = lambda _: None,
    num_threads: int | None = None,
) -> Outcome:
    """Add the planes of a source as they come, and update the run folder after each.

    source: scene or GeRaF-SENS folder, ROS 2 bag or DCA1000 file that grows or is whole; or a
    socket of this machine, tcp://localhost:PORT or unix:PATH.
    out: run folder; a session that is there continues. on_plane: called after each plane, and for
    each that is left out.

    Ends when all announced planes came, when the target is reached, or when no plane came for a
    time. Raises UserError if no plane came, or there is no surface at the end.
    """
    ending, heard = ending or LiveOptions(), _Once(listener or Listener())

    def begin(about: Capture) -> Session:
        return Session(about, prior, preset, out, num_threads=num_threads, listener=heard)

    with _Follower(begin, on_plane, ending.until) as follower, ExitStack() as stack:

        def open_feed() -> Source | None:
            feed = open_source(source, ending.radar, ending.recording)
            return feed and stack.enter_context(closing(feed))

        reason = _follow_source(open_feed, follower, ending, heard)
        session = follower.session
        if session is None:
            raise UserError(
                what="no plane came", where=source, hint="wait longer for one with --idle"
            )
        result = session.finish(report=ending.report)
        return Outcome(result=result, n_planes=len(session), reason=reason)


def _follow_source(
    open_feed: Callable[[], Source | None],
    follower: "_Follower",
    ending: LiveOptions,
    listener: Listener,
) -> str:
    """Add planes until the scan is over; the reason."""
    feed: Source | None = None
    last_s = time.monotonic()
    while True:
        feed = feed or open_feed()
        if feed is not None:
            last_s = max(last_s, feed.last_s)
        is_last = time.monotonic() - last_s > ending.idle_s
        for new in feed.poll(is_last=is_last) if feed is not None else ():
            for note in feed.notes if feed is not None else ():
                listener.warning(note)
            if follower.add(new, feed.about if feed is not None else None):
                return "the target is reached"
            last_s = time.monotonic()
        if feed is not None and feed.ending:
            return feed.ending
        if is_last:
            return f"no plane came for {ending.idle_s:g} s"
        time.sleep(_POLL_S)


class _Follower:
    """Adds planes to a session, which begins with the first."""

    def __init__(
        self,
        begin: Callable[[Capture], Session],
        on_plane: Callable[[PlaneReport], None],
        until: Target | None,
    ) -> None:
        self._begin, self._on_plane, self._until = begin, on_plane, until
        self.session: Session | None = None
        self._before: frozenset[str] = frozenset()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self.session is not None:
            self.session.close()

    def add(self, new: NewPlane, about: Capture | None) -> bool:
        """Add a plane, or report why not; whether the target is reached."""
        if new.pose is None or about is None:
            return self._report_left_out(new, new.problem)
        if self.session is None:
            self.session = self._begin(about)
            self._before = self.session.digests
        session, start = self.session, time.perf_counter()
        if digest_samples(new.pose) in self._before:
            return False  # by a process that was stopped
        try:
            session.add(new.pose)
        except UserError as error:
            return self._report_left_out(new, str(error))
        found = _surface_numbers(session)
        seconds = round(time.perf_counter() - start, 2)
        report = PlaneReport(
            plane=len(session), name=new.name, seconds=seconds, n_peaks=session.n_peaks, **found
        )
        verdict = None if report.verdict is None else report.verdict.trust
        session.run.log(PLANE_EVENT, **asdict(report) | {"verdict": verdict})
        self._on_plane(report)
        return self._until is not None and session.reaches(self._until)

    def _report_left_out(self, new: NewPlane, problem: str) -> bool:
        n_planes = 0 if self.session is None else len(self.session)
        self._on_plane(
            PlaneReport(plane=n_planes, name=new.name, problem=problem, is_left_out=True)
        )
        return False


def _surface_numbers(session: Session) -> dict[str, Any]:
    """Numbers of the surface so far, or why there is none."""
    try:
        result = session.result
    except UserError as error:
        return {"problem": str(error)}
    numbers = result.numbers["mesh"]
    return {
        "expected_error_mm": numbers.get("expected_error_median_mm"),
        "seen_share": numbers["evidence_shares"]["seen"],
        "stated_f1": result.stated_f1,
        "verdict": result.verdict,
    }


class _Once(Listener):
    """Passes each message on once: every update of a session repeats them."""

    def __init__(self, listener: Listener) -> None:
        self._listener = listener
        self._heard = set[str]()

    def _is_new(self, text: str) -> bool:
        kind = _NUMBERS.sub("", text)
        is_new = kind not in self._heard
        self._heard.add(kind)
        return is_new

    def warning(self, text: str) -> None:
        """Pass on a warning."""
        if self._is_new(text):
            self._listener.warning(text)

    def note(self, text: str) -> None:
        """Pass on a note."""
        if self._is_new(text):
            self._listener.note(text)

    def findings(self, findings: Iterable[Finding]) -> None:
        """Pass on findings."""
        self._listener.findings([one for one in findings if self._is_new(str(one))])
