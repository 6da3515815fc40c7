"""Comparison of a run with reference runs of the same packed box."""

from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from geraf2._types import Floats
from geraf2._validation import require_positive
from geraf2.apps.inspection.bodies import content_of
from geraf2.apps.inspection.coherent_change import Signals, Spots, compare_echoes, refine_turn
from geraf2.apps.inspection.comparison import (
    Comparison,
    Play,
    Scanned,
    common_changes,
    compare_scans,
    register_scans,
)
from geraf2.apps.inspection.materials import levels_of, materials_of, returns_of
from geraf2.apps.inspection.scan_evidence import LIKELY, Evidence
from geraf2.apps.inspection.workers import Workers
from geraf2.errors import UserError
from geraf2.geometry.transforms import apply_rigid, inverse_rigid, rigid, triple
from geraf2.io.mesh import read_mesh
from geraf2.io.planes import load_planes
from geraf2.io.points import read_cloud
from geraf2.io.run_folder import (
    BOX_NAME,
    COMPARISON_NAME,
    PEAKS_NAME,
    PLANES_NAME,
    PRIOR_NAME,
    place_of,
)
from geraf2.io.verdict import Verdict
from geraf2.pipeline.events import Listener
from geraf2.pipeline.reconstruction import Reconstruction, load_run
from geraf2.pipeline.run_scene import capture_of
from geraf2.scene import LosPrior
from geraf2.scene.aperture import apertures_at

_SAME_SIDE_M, _SAME_WAVELENGTH = 0.015, 0.01
"""Largest difference of the sides of one box [m], and of one radar's wavelengths as a share."""
_IN_BOX = Play(turn_rad=float(np.deg2rad(0.3)), shift_m=0.0005)
"""Play of content in a box whose walls both scans show: errors of the walls."""
_FREE = Play(turn_rad=float(np.deg2rad(3.0)), shift_m=0.005)
"""Play of content without walls."""
_IN_PHASE = Play(turn_rad=float(np.deg2rad(0.1)), shift_m=0.0005)
"""Play of content whose turn the phases show."""


def compare(
    run: Reconstruction | Path | str,
    references: Sequence[Reconstruction | Path | str],
    *,
    tolerance_mm: float = 0.5,
    out: Path | str | None = None,
    write: bool = True,
    num_threads: int | None = None,
    listener: Listener | None = None,
) -> Comparison:
    """Compare a run with runs of the same packed box: what appeared, vanished, moved, was swapped.

    Box and content are registered first: the box may have been put down elsewhere. What one of the
    scans could not see is no change. With several references only what differs from all of them is.

    Parameters
    ----------
    run
        A reconstruction, or its folder.
    references
        At least one, of the same box and radar.
    tolerance_mm
        Largest shift of a part that is no change [mm].
    out
        Folder for `comparison.json`, `.html` and `.glb`; the run folder when None.
    write
        Whether to write these files.
    num_threads
        Threads of the kernels; all when None.
    listener
        Receives warnings and progress.

    Returns
    -------
    Comparison
        Changes with their probabilities, middles (3,) and sizes [m]; none, and `changed` None,
        where one of the runs is not to be trusted.

    Raises
    ------
    UserError
        For a run without a surface or peaks, or a reference of another box, radar or view.
    ValueError
        For a tolerance that is not positive.

    Examples
    --------
    >>> run = geraf2.examples.small_run()
    >>> geraf2.compare(run, [run]).changed
    False
    """
    require_positive("tolerance_mm", tolerance_mm)
    if not references:
        raise UserError(what="there is no reference", expected="at least one run")
    listener = listener or Listener()
    here = run if isinstance(run, Reconstruction) else load_run(run)
    others = [r if isinstance(r, Reconstruction) else load_run(r) for r in references]
    for one in (here, *others):
        _require_peaks(one)
    for other in others:
        _require_alike(here, other)
    scanned, before, found = _read_scan(here), list[Scanned](), []
    signals = _signals(here, listener)
    for other in others:
        with listener.step("registering a reference"):
            there = _read_scan(other)
            start, play = _register_by_walls(here, other)
        with listener.step("comparing echoes"):
            received = signals, _signals(other, listener)
            start, play, spots = _register_in_phase(
                scanned, there, received, (start, play), num_threads
            )
            found.append(compare_scans(scanned, there, start, play, 1e-3 * tolerance_mm, spots))
        if found[-1][2] == 0.0:
            raise UserError(
                what="the scans show different sides of the content",
                where=other.path,
                expected="a surface in view of both",
                hint="put the box down as in the reference, and scan it with the same planes",
            )
        before.append(there)
    changes, poses, shares = zip(*found, strict=True)
    middle = scanned.whole.mesh.vertices.mean(axis=0)
    comparison = Comparison(
        changes=common_changes(changes),
        n_parts=(len(scanned.bodies), *(len(one.bodies) for one in before)),
        shift_m=triple(middle - apply_rigid(poses[0], middle)),
        turn_deg=float(np.rad2deg(Rotation.from_matrix(poses[0][:3, :3]).magnitude())),
        compared_fraction=min(shares),
        tolerance_m=1e-3 * tolerance_mm,
        verdict=Verdict.joined({str(r.path): r.verdict for r in (here, *others) if r.verdict}),
    ).weighed()
    if write:
        with listener.step("drawing the page"):
            back = inverse_rigid(poses[0][:3, :3], poses[0][:3, 3])
            _write(comparison, scanned, before[0].move(back), here, others[0], out)
    return comparison


def _write(
    found: Comparison,
    here: Scanned,
    before: Scanned,
    run: Reconstruction,
    reference: Reconstruction,
    out: Path | str | None,
) -> None:
    # takes 0.5 s
    from geraf2.apps.inspection.comparison_page import write_comparison  # noqa: PLC0415

    box = run.run.find_file(BOX_NAME)
    title = f"What changed: {place_of(run.path)} against {place_of(reference.path)}"
    mesh = read_mesh(box) if box else None
    rewriting = run.run.rewrite(f"{COMPARISON_NAME}.*") if out is None else nullcontext()
    with rewriting:
        write_comparison(found, here, before, mesh, Path(out or run.path), title)


def _read_scan(result: Reconstruction) -> Scanned:
    """Content and evidence of a run."""
    glints = result.glints
    assert glints is not None  # as of _require_peaks
    whole, bodies = content_of(result, has_samples=False)
    planes = load_planes(result.path / PLANES_NAME)
    apertures = apertures_at(planes.corners_m)
    evidence = Evidence(
        glints=glints.select(glints.probability > LIKELY),
        peaks=read_cloud(result.path / PEAKS_NAME)[:2],
        apertures=apertures,
    )
    materials = materials_of(bodies, levels_of(result, planes), returns_of(result))
    return Scanned(whole, bodies, evidence, materials)


def _prior(result: Reconstruction) -> LosPrior | None:
    return result.prior if (result.path / PRIOR_NAME).is_file() else None


def _signals(result: Reconstruction, listener: Listener) -> Signals | None:
    """Return what a run's scan received; None, with a note, where its scene cannot be read."""
    try:
        capture, prior = capture_of(result, None), _prior(result)
    except UserError as error:
        reason = str(error).partition(";")[0]  # its hint is an option of other commands
        listener.note(f"echoes are not compared in phase: {reason}")
        return None
    plane_middles = np.array([pose.phase_centers.mean(axis=0) for pose in capture.poses])
    return Signals(capture, plane_middles, None if prior is None else prior.cuboid)


def _register_in_phase(
    here: Scanned,
    there: Scanned,
    received: tuple[Signals | None, Signals | None],
    registration: tuple[Floats, Play],
    num_threads: int | None,
) -> tuple[Floats, Play, Spots | None]:
    """Pose with its turn by the phases, its play, and the echoes; the same and None without scenes.

    registration: pose and play by the walls.
    """
    (start, play), (one, other) = registration, received
    if one is None or other is None:
        return start, play, None
    if play is _FREE:
        start = register_scans(here, there, start, play)[0]
    peaks = here.evidence.peaks[0], there.evidence.peaks[0]
    with Workers(num_threads) as workers:
        start = refine_turn(start, one, other, peaks, workers)
        return start, _IN_PHASE, compare_echoes(start, one, other, peaks, workers)


def _require_peaks(result: Reconstruction) -> None:
    """Raise UserError for a preset without peaks."""
    if result.glints is None or result.run.find_file(PEAKS_NAME) is None:
        raise UserError(
            what="the run has no peaks to compare",
            where=result.path,
            expected="a run of preset best or fast",
        )


def _register_by_walls(here: Reconstruction, there: Reconstruction) -> tuple[Floats, Play]:
    """Pose that moves one box onto the other, (4, 4), and the play of the content beside it."""
    priors = _prior(here), _prior(there)
    cuboids = [prior.cuboid for prior in priors if prior is not None and prior.cuboid is not None]
    if len(cuboids) < 2:
        return np.eye(4), _FREE
    (axes, _, middle), (to_axes, _, to_middle) = cuboids
    turn = to_axes.T @ axes
    return rigid(turn, to_middle - turn @ middle), _IN_BOX


def _require_alike(here: Reconstruction, there: Reconstruction) -> None:
    """Raise UserError where the reference is of another box or radar."""
    box, other = _prior(here), _prior(there)
    if box is not None and other is not None:
        sides, to = (np.array(p.cuboid[1] if p.cuboid else p.size_m) for p in (box, other))
        if np.abs(sides - to).max() > _SAME_SIDE_M:
            raise UserError(
                what="the reference is of another box",
                where=there.path,
                expected=_size_text(sides),
                got=_size_text(to),
            )
    one, two = (load_planes(r.path / PLANES_NAME).wavelength_m for r in (here, there))
    if one is not None and two is not None and abs(two / one - 1.0) > _SAME_WAVELENGTH:
        raise UserError(
            what="the reference is of another radar",
            where=there.path,
            expected=f"a wavelength of {1e3 * one:.2f} mm",
            got=f"{1e3 * two:.2f} mm",
        )


def _size_text(sides_m: Floats) -> str:
    return "a box of " + " x ".join(f"{1e3 * side:.0f}" for side in sides_m) + " mm"
