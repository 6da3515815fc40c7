"""Inspection of a run: its parts, and comparison with CAD models."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
from annotated_types import Interval
from scipy.spatial import KDTree

from geraf2._bounds import Arg, Bounded, Seed
from geraf2._types import Floats
from geraf2._validation import require_between
from geraf2.apps.inspection.arrangement import arrange_models, cut_apart
from geraf2.apps.inspection.bodies import (
    Body,
    BodyReport,
    Content,
    content_of,
    measure,
    small_bodies,
)
from geraf2.apps.inspection.deviation import Deviation, deviation_of
from geraf2.apps.inspection.expected import (
    ExpectedContents,
    absence_failures,
    material_findings,
    read_expected,
)
from geraf2.apps.inspection.expected_echoes import ExpectedEchoes, Patches
from geraf2.apps.inspection.matching import Match, match_models, refine_by_echoes
from geraf2.apps.inspection.materials import (
    add_reflectivity,
    levels_of,
    materials_of,
    returns_of,
)
from geraf2.apps.inspection.models import CadModel, diagonal_m, model_of, read_models
from geraf2.apps.inspection.registration import ALIKE
from geraf2.apps.inspection.result import Inspection, ModelReport, failures_of
from geraf2.echoes.ruled_out import ruled_out_of
from geraf2.errors import UserError
from geraf2.io.atomic import write_bytes_atomic, write_text_atomic
from geraf2.io.mesh import TriangleMesh, read_mesh, write_mesh
from geraf2.io.planes import ScannedPlanes, load_planes
from geraf2.io.run_folder import BOX_NAME, INSPECTION_NAME, PLANES_NAME, place_of
from geraf2.io.verdict import confidence
from geraf2.pipeline.events import Listener
from geraf2.pipeline.planes import keep_planes
from geraf2.pipeline.reconstruction import Reconstruction, as_triangles, load_run
from geraf2.pipeline.run_scene import capture_of
from geraf2.scene import Capture

if TYPE_CHECKING:
    import trimesh

_CUT = "parts are connected in the surface, which was cut between the models"


@dataclass(frozen=True, kw_only=True)
class InspectOptions(Bounded):
    """Options of an inspection.

    Raises
    ------
    ValueError
        For numbers out of their range.

    Examples
    --------
    >>> geraf2.InspectOptions(tolerance_mm=1.5).min_seen  # 0 to 1
    0.2
    """

    tolerance_mm: Annotated[float, Interval(gt=0.0, le=1000.0)] = 2.0
    """Largest deviation from a model that passes, beyond the measurement's uncertainty [mm]."""
    min_seen: Annotated[float, Interval(ge=0.0, le=1.0)] = 0.2
    """Share of a model that must have been seen for it to pass, 0 to 1."""
    unit: Literal["mm", "cm", "m", "in"] | None = None
    """Unit of the CAD files; inferred from the size of the content when not given."""
    any_of: bool = False
    """The models are candidates: each part gets the best one, and none is required."""
    placed: bool = False
    """The models are at their nominal poses in the capture's frame: turned and moved ones fail."""
    scene: Path | None = None
    """Scene folder of the run, if it was moved since."""
    seed: Annotated[Seed, Arg(hidden=True)] = 0
    """Seed of the points that are drawn from surfaces."""


def inspect(
    run: Reconstruction | Path | str,
    cad: "Sequence[Path | str | TriangleMesh | trimesh.Trimesh]" = (),
    *,
    expect: int | Path | str | None = None,
    options: InspectOptions | None = None,
    out: Path | str | None = None,
    write: bool = True,
    num_threads: int | None = None,
    listener: Listener | None = None,
) -> Inspection:
    """Inspect a run: list the parts in the box and compare them with CAD models.

    Parameters
    ----------
    run
        A reconstruction, or its folder.
    cad
        Models to find: files, or meshes in metres. Each must be closed.
    expect
        Required number of parts, or the file of a list of contents.
    options
        Tolerance, least share that was seen, and unit of the files.
    out
        Folder for `inspection.json`, `.csv`, `.html`, `.glb` and `.ply`; the run folder when None.
    write
        Whether to write these files.
    num_threads
        Threads of the kernels; all when None.
    listener
        Receives warnings and progress.

    Returns
    -------
    Inspection
        Parts with positions and lengths [m], models with poses (4, 4) and deviations [m], and the
        result. Of a scan that is not to be trusted, no model is compared, and it is not determined
        which parts exist, what they are made of, and how large they are.

    Raises
    ------
    UserError
        If the run has no surface, a file is no closed mesh or as large as nothing in the box, or
        the list of contents cannot be read.
    ValueError
        If `expect` is no number of parts.

    Examples
    --------
    >>> answer = geraf2.inspect(geraf2.examples.small_run(), write=False)
    >>> answer.result, answer.parts[0].volume_m3.value > 0
    ('not judged', True)
    """
    listener, options = listener or Listener(), options or InspectOptions()
    result = run if isinstance(run, Reconstruction) else load_run(run)
    scan = None if options.scene is None else capture_of(result, options.scene)
    contents, cad = _read_contents(expect, cad)
    (whole, pieces), glints = content_of(result), result.glints
    tolerance_m, bodies, matches = 1e-3 * options.tolerance_mm, pieces, list[Match]()
    models, planes = _models(cad, [*pieces, whole], options, contents), _planes(result.path)
    has_criteria, share = bool(models) or expect is not None, confidence(result.verdict)
    if not share:
        models, contents, expect = [], None, None
    if models:
        bodies, matches = _match_models(models, Content(pieces, whole, glints), options, listener)
    notes = [_CUT] if len(bodies) > len(pieces) else []
    notes += small_bodies(pieces, glints)
    with listener.step("measuring the parts"):
        levels = levels_of(result, planes)
        whole = replace(whole, mesh=add_reflectivity(whole.mesh, levels))
        measured = map(measure, bodies, materials_of(bodies, levels, returns_of(result)))
        parts = tuple(part.weighed(share) for part in measured)
    patches: dict[int, Patches] = {}
    if any(match.placement is not None for match in matches):
        with listener.step("comparing expected echoes"):
            matches, patches, more = _compare_echoes(
                result, scan, matches, models, options, num_threads
            )
            notes += more
    compare = partial(
        deviation_of, tolerance_m=tolerance_m, planes=planes, glints=glints, num_threads=num_threads
    )
    content = Content(bodies, whole, glints)
    reports = _reports(models, matches, patches, content, compare, listener)
    failures, more = _failures(parts, reports, contents, expect, options)
    inspection = Inspection(
        parts=parts,
        models=reports,
        failures=tuple(failures),
        notes=(*notes, *more, *_rival_notes(reports, models), *_notes(reports, bodies, options)),
        tolerance_m=tolerance_m,
        scene=(result.run.scene_name, result.run.scene_digest),
        has_criteria=has_criteria,
        verdict=result.verdict,
        ruled_out=tuple(ruled_out_of(result.numbers.get("mesh", {}))),
    )
    if write:
        _write(inspection, result, bodies, whole, out, listener)
    return inspection


def _match_models(
    models: Sequence[CadModel], content: Content, options: InspectOptions, listener: Listener
) -> tuple[list[Body], list[Match]]:
    """Parts and matches; connected parts are cut where a model is not found alone."""

    def match(
        content: Content, given: Mapping[int, tuple[int, Floats]] | None = None
    ) -> list[Match]:
        with listener.step("finding the models") as progress:
            return match_models(
                models,
                content,
                any_of=options.any_of,
                placed=options.placed,
                given=given,
                seed=options.seed,
                progress=progress,
            )

    matches = match(content)
    all_present = all(one.status not in ("missing", "wrong part") for one in matches)
    if all_present or options.any_of or len(models) < 2:
        return list(content.bodies), matches
    meshes = [model.mesh for model in models]
    with listener.step("separating connected parts") as progress:
        placements = arrange_models(
            meshes, content.whole, content.glints, seed=options.seed, progress=progress
        )
    bodies, body_of_model = cut_apart(content.bodies, meshes, placements)
    given = {m: (b, p.pose) for m, b in body_of_model.items() if (p := placements[m])}
    return bodies, match(content._replace(bodies=bodies), given)


def _read_contents(
    expect: int | Path | str | None,
    cad: "Sequence[Path | str | TriangleMesh | trimesh.Trimesh]",
) -> "tuple[ExpectedContents | None, Sequence[Path | str | TriangleMesh | trimesh.Trimesh]]":
    """List of contents, if there is one, and the CAD models to find."""
    if expect is None or isinstance(expect, int):
        require_between("expect", expect or 0, -1, 10_001)
        files = [Path(item).resolve() for item in cad if isinstance(item, Path | str)]
        twice = [path for n, path in enumerate(files) if path in files[:n]]
        if twice:
            raise UserError(
                what="the same CAD file is given twice",
                where=twice[0],
                hint="a list of contents (--expect contents.toml) states how many there are",
            )
        return None, cad
    if len(cad):
        raise UserError(what="the list of contents names its CAD files", got="others, too")
    contents = read_expected(Path(expect))
    return contents, [str(item.cad) for item in contents.models]


def _failures(
    parts: Sequence[BodyReport],
    reports: Sequence[ModelReport],
    contents: ExpectedContents | None,
    expect: int | Path | str | None,
    options: InspectOptions,
) -> tuple[list[str], list[str]]:
    """Reasons of a failure, and what a list of contents leaves unknown, a sentence each."""
    count, failures = expect if isinstance(expect, int) else None, list[str]()
    found, notes = failures_of(parts, reports, expect=count, min_seen=options.min_seen), list[str]()
    missing = [report.model for report in reports if report.match.status == "missing"]
    taken = {report.match.body for report in reports}
    spare = [] if -1 in taken else [b for b in range(len(parts)) if b not in taken]
    if contents is not None:
        pairs = [
            (contents.models[match.model], parts[match.body])
            for match in (report.match for report in reports)
            if match.body is not None and match.body >= 0 and match.status == "present"
        ]
        failures, notes = material_findings(pairs)
    absent = absence_failures(parts, missing, spare, is_list=contents is not None)
    return [*found, *failures, *absent], notes


def _models(
    cad: "Sequence[Path | str | TriangleMesh | trimesh.Trimesh]",
    bodies: Sequence[Body],
    options: InspectOptions,
    contents: ExpectedContents | None,
) -> list[CadModel]:
    sizes = [diagonal_m(body.mesh.vertices) for body in bodies]
    paths = [item for item in cad if isinstance(item, Path | str)]
    read = iter(read_models(paths, sizes, options.unit))
    models = [
        next(read)
        if isinstance(item, Path | str)
        else model_of(as_triangles(item, "CAD model"), f"model {number}")
        for number, item in enumerate(cad, 1)
    ]
    if contents is None:
        return models
    named = zip(models, contents.models, strict=True)
    return [replace(model, name=item.name) for model, item in named]


def _compare_echoes(
    result: Reconstruction,
    scan: Capture | None,
    matches: list[Match],
    models: Sequence[CadModel],
    options: InspectOptions,
    num_threads: int | None,
) -> tuple[list[Match], dict[int, Patches], list[str]]:
    """Refine matches by expected echoes; returns their patches, and a note without a scan, too."""
    # scan: that of the run's record when None.
    try:
        scan = capture_of(result, None) if scan is None else scan
        scan = keep_planes(scan, result.record.options.hold_out, result.run.scene_name)
        expected = ExpectedEchoes(scan, result.prior, seed=options.seed, num_threads=num_threads)
    except UserError as error:
        if options.scene is not None:
            raise
        return matches, {}, [f"poses rest on the run alone, not on its scan: {error}"]
    moved, patches = refine_by_echoes(matches, models, expected, placed=options.placed)
    if patches:
        return moved, patches, []
    return moved, {}, ["the models explain less than half of the echoes: poses rest on glints"]


def _reports(
    models: Sequence[CadModel],
    matches: Sequence[Match],
    patches: Mapping[int, Patches],
    content: Content,
    compare: Callable[..., Deviation],
    listener: Listener,
) -> tuple[ModelReport, ...]:
    """Report on each model, with its own comparison of surfaces where it was found."""
    # patches: of each match with expected echoes. compare: `deviation_of` with what all have in
    # common.
    reports = list[ModelReport]()
    if not matches:
        return ()
    with listener.step("comparing surfaces") as progress:
        for n, match in enumerate(matches):
            model, deviation = models[match.model], None
            if match.placement is not None and match.status != "wrong part":
                body = _measured_body(match, content.bodies, content.whole)
                deviation = compare(body, model.mesh, match.placement, echoes=patches.get(n))
            reports.append(ModelReport(model=model, match=match, deviation=deviation))
            progress((n + 1) / len(matches))
    return tuple(reports)


def _measured_body(match: Match, bodies: Sequence[Body], whole: Body) -> Body:
    """Part of a match, or all of the content."""
    return whole if match.body is None or match.body < 0 else bodies[match.body]


def _rival_notes(reports: Sequence[ModelReport], models: Sequence[CadModel]) -> list[str]:
    """Sentence on each candidate that fits a part worse than the one that was taken."""
    return [
        f"'{models[m].name}' fits part {(report.match.body or 0) + 1} worse than "
        f"'{report.model.name}': misfit {misfit:.2f} against {placement.misfit:.2f}"
        for report in reports
        if (placement := report.match.placement) is not None
        for m, misfit in report.match.rivals
    ]


def _notes(
    reports: Sequence[ModelReport], bodies: Sequence[Body], options: InspectOptions
) -> tuple[str, ...]:
    notes = [
        f"{report.model.name} is assumed to be in {report.model.unit}, by its size"
        for report in reports
        if options.unit is None and report.model.unit not in ("mm", "m")
    ]
    if len(reports) > len(bodies) and not options.any_of:
        notes.append(f"{len(reports)} models, but only {len(bodies)} parts in the box")
    for report in reports:
        placement = report.match.placement
        if placement is None or report.match.status == "wrong part":
            continue
        if placement.free_axis is not None:
            notes.append(f"the turn of {report.model.name} about one axis cannot be determined")
        rival = placement.rival_misfit
        if rival is not None and rival < ALIKE * placement.misfit:
            notes.append(f"{report.model.name} fits about as well in another pose")
    return tuple(notes)


def _planes(folder: Path) -> ScannedPlanes:
    """Planes of a run's antennas; none where its file of them cannot be read."""
    try:
        return load_planes(folder / PLANES_NAME)
    except UserError:
        return ScannedPlanes(corners_m=np.zeros((0, 4, 3)))


def _write(
    inspection: Inspection,
    result: Reconstruction,
    bodies: Sequence[Body],
    whole: Body,
    out: Path | str | None,
    listener: Listener,
) -> None:
    # matplotlib takes 0.5 s
    from geraf2.apps.inspection.page import inspection_page, parts_glb  # noqa: PLC0415

    box, n, tree = result.run.find_file(BOX_NAME), len(whole.seen), KDTree(whole.mesh.vertices)
    labelled = ((body, np.full(len(body.seen), float(k))) for k, body in enumerate(bodies, 1))
    numbers = _put_on_content(tree, labelled, np.zeros(n)).astype(np.int64)  # 0: ghosts and crumbs
    known = [
        (_measured_body(report.match, bodies, whole), report.deviation.values_m)
        for report in inspection.models
        if report.deviation is not None
    ]
    with listener.step("drawing the page"):
        page = inspection_page(
            inspection,
            whole,
            _put_on_content(tree, known, np.full(n, np.nan)) if known else None,
            numbers,
            box=read_mesh(box) if box else None,
            title=f"Parts in {place_of(result.path)}",
        )

    def write(folder: Path) -> None:
        inspection.write(folder / INSPECTION_NAME)
        write_text_atomic(folder / f"{INSPECTION_NAME}.html", page)
        write_bytes_atomic(folder / f"{INSPECTION_NAME}.glb", parts_glb(whole, numbers))
        if whole.mesh.reflectivity_db is not None:
            write_mesh(whole.mesh, folder / f"{INSPECTION_NAME}.ply")

    if out is not None:
        Path(out).mkdir(parents=True, exist_ok=True)
        write(Path(out))
        return
    with result.run.rewrite(f"{INSPECTION_NAME}.*"):
        write(result.path)


def _put_on_content(tree: KDTree, found: Iterable[tuple[Body, Floats]], values: Floats) -> Floats:
    """Values of the vertices of parts, put over those of all of the content, (n_vertices,)."""
    # tree: of the vertices of the content.
    for body, own in found:
        gap, at = tree.query(body.mesh.vertices)
        values[at[gap == 0.0]] = own[gap == 0.0]  # a cut made the others
    return values
