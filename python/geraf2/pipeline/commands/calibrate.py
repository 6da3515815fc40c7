"""From a scene to a scene without its errors of delay, channels, frame and positions."""

import shutil
from dataclasses import dataclass, replace
from pathlib import Path

from geraf2 import __version__
from geraf2._bounds import Triple
from geraf2.calibration.box_finder import find_box
from geraf2.calibration.corrections import with_delay
from geraf2.calibration.cuboid_search import DelayUnknownError
from geraf2.calibration.driver import Calibration, CalibrationConfig
from geraf2.calibration.driver import calibrate as calibrate_capture
from geraf2.calibration.found_box import NoBoxError
from geraf2.errors import UserError
from geraf2.io.container import (
    LOS_NAME,
    MANIFEST_NAME,
    RADAR_NAME,
    read_scene_manifest,
    require_scene_folder,
)
from geraf2.io.manifest import CalibrationManifest
from geraf2.io.mesh import write_mesh
from geraf2.ops._threads import limit_blas_threads
from geraf2.pipeline.box_check import box_from_radar, stated_box
from geraf2.pipeline.events import Listener
from geraf2.pipeline.prior import PriorSource, add_walls
from geraf2.pipeline.sign_check import explain_sign_errors
from geraf2.scene import Capture, LosPrior, load_capture, save_capture
from geraf2.scene.checks import require_plausible
from geraf2.scene.summary import CaptureSummary, summarize_capture


@dataclass(frozen=True, kw_only=True, eq=False)
class CalibratedScene:
    """Corrections of a scene; nothing is written before `save`."""

    scene: Path
    """Folder of the uncorrected scene."""
    found: Calibration
    """The corrected capture, `table` among its records."""
    table: CalibrationManifest
    """Corrections, as scene.toml keeps them; SI units, uncertainties of one sigma."""

    def rows(self) -> list[tuple[str, str]]:
        """Names and values of the corrections, for printing."""
        table, found = self.table, self.found
        sigma = table.path_bias_sigma_m
        delay = f"{table.path_bias_before_m:.4f} -> {table.path_bias_m:.4f}"
        delay += f" +- {sigma:.4f}" if sigma is not None else ""
        pairs = [("instrument delay", f"{delay} m on the two-way path ({table.delay_from})")]
        if (walls := found.walls) is not None:
            before, after = walls.rms_m
            rms = f"{1e3 * before:.2f} -> {1e3 * after:.2f} mm rms"
            n_echoes = len(walls.offsets_after_m)
            pairs.append(("walls", f"{n_echoes} echoes, {rms} about the prior"))
        judged = ((one.name, str(one).removeprefix(f"{one.name}: ")) for one in found.judgements)
        return [*pairs, *judged]

    def save(
        self, out: Path | str, *, overwrite: bool = False, listener: Listener | None = None
    ) -> None:
        """Write the corrected scene, whole or not at all, with los.ply.

        All other files of the scene go with it. `out` may be the scene itself, with `overwrite`.
        Raises UserError where `out` holds something else.
        """
        listener = listener or Listener()
        capture = self.found.capture

        def write_extras(folder: Path) -> None:
            made = {MANIFEST_NAME, RADAR_NAME, LOS_NAME, LOS_NAME + ".json"}
            for entry in sorted(self.scene.iterdir()):
                if entry.name in made or entry.is_symlink():
                    continue
                copy = shutil.copytree if entry.is_dir() else shutil.copy2
                copy(entry, folder / entry.name)
            made_from = {"scene": self.table.scene, "prior": self.table.prior}
            write_mesh(
                self.found.prior.mesh,
                folder / LOS_NAME,
                frame=capture.frame,
                made_from={**made_from, "command": "geraf2 calibrate"},
            )

        if capture.walls and self.table.prior_to_capture is not None:
            listener.warning("walls in scene.toml keep their position; the moved box is in los.ply")
        with listener.step("writing"):
            save_capture(capture, out, overwrite=overwrite, extras=write_extras)


@limit_blas_threads
def calibrate(
    scene: Path | str,
    prior: LosPrior | PriorSource | Path | str | Triple | None = None,
    config: CalibrationConfig | None = None,
    *,
    num_threads: int | None = None,
    listener: Listener | None = None,
) -> CalibratedScene:
    """Find errors of delay, channels, frame and positions; see `geraf2.calibration.driver`.

    Parameters
    ----------
    scene
        Folder of the scene, which does not change.
    prior
        Outside of the box, roughly in the capture frame: a prior, a mesh file, a folder of
        `geraf2 los`, or the three outer side lengths [m]. When None, the box that the scene states,
        else the one that its radar sees.
    config
        Corrections that are searched.
    num_threads
        Threads of the kernels; all when None.
    listener
        Receives the step "calibrating" and what is implausible about the scene.

    Returns
    -------
    CalibratedScene
        Corrections [m, rad] and the corrected capture; `save` writes it.

    Raises
    ------
    UserError
        If the scene is not plausible, no box is given, stated or seen, or the echoes of walls are
        too weak.

    Examples
    --------
    >>> from geraf2.calibration.driver import CalibrationConfig
    >>> geraf2.save_capture(geraf2.examples.small_capture()[0], "recorded")
    True
    >>> only_delay = CalibrationConfig(frame=False, channels=False, positions=False)
    >>> found = geraf2.calibrate("recorded", geraf2.examples.BOX_M, only_delay)
    >>> round(found.table.path_bias_m, 2)  # [m]
    0.15
    """
    listener, config = listener or Listener(), config or CalibrationConfig()
    capture = load_capture(scene)
    summary = summarize_capture(capture)
    listener.findings(require_plausible(summary, scene))
    source = PriorSource.from_argument(prior)
    if isinstance(prior, LosPrior):
        outside, name = prior, "given"
    elif source.is_given:
        outside, name = source.load(listener=listener)
        name = name if source.los is None else source.los.name
    else:
        outside, name = stated_box(capture) or _seen_box(capture, summary, listener, num_threads)
    outside = outside if outside.walls else add_walls(outside, capture.walls, listener)
    placed, alignment = capture, config.alignment
    if config.delay and alignment.delay_search_m is None:
        placed, change_m = _at_delay_of_box(capture, outside, listener, num_threads)
        alignment = alignment.after(change_m)
    with listener.step("calibrating") as report:
        found = calibrate_capture(
            placed,
            outside,
            replace(config, alignment=alignment),
            num_threads=num_threads,
            progress=report,
        )
    for one in found.judgements:
        if one.error is not None:  # it was asked for
            with explain_sign_errors(capture, scene, num_threads):
                raise one.error
    values = {
        "scene": Path(scene).resolve().name,
        "prior": name,
        "software": f"geraf2 {__version__}",
        **_values(capture, found, config),
    }
    table = CalibrationManifest.model_validate(values)
    corrected = replace(found.capture, calibration=(*capture.calibration, table))
    return CalibratedScene(scene=Path(scene), found=replace(found, capture=corrected), table=table)


def _seen_box(
    capture: Capture, summary: CaptureSummary, listener: Listener, num_threads: int | None
) -> tuple[LosPrior, str]:
    """Box by radar, as `reconstruct` finds it, and its name; UserError where no walls are seen."""
    box = box_from_radar(capture, summary, listener, num_threads)
    if box.found is None:
        raise UserError(
            what="no walls of a box are seen, whose echoes calibration needs",
            hint="give the outside of the box by --box X Y Z or --los MESH",
        )
    listener.note(box.text)
    return box.prior, box.name


def _at_delay_of_box(
    capture: Capture, prior: LosPrior, listener: Listener, num_threads: int | None
) -> tuple[Capture, float]:
    """Capture with the delay at which its walls lie on one box, as `reconstruct` finds it.

    Also returns the change of the delay [m].
    """
    change_m = 0.0
    try:
        box = find_box(capture, expected=prior, num_threads=num_threads)
        change_m = box.delay_change_m
        if change_m:
            listener.note(str(box.delay))
    except NoBoxError as error:
        change_m = error.delay_change_m
    except DelayUnknownError:
        if prior.cuboid is not None:
            raise
    return (with_delay(capture, change_m) if change_m else capture), change_m


def require_room(scene: Path, out: Path | None, *, overwrite: bool) -> None:
    """Refuse before the work an `out` that :meth:`CalibratedScene.save` would refuse after it."""
    if out is not None:
        before, name = read_scene_manifest(scene).calibration, scene.resolve().name
        require_scene_folder(
            out,
            overwrite=overwrite,
            may_be_same=lambda old: (
                old.manifest.calibration[:-1] == before
                and [c.scene for c in old.manifest.calibration[-1:]] == [name]
            ),
        )


def _values(before: Capture, found: Calibration, config: CalibrationConfig) -> dict[str, object]:
    """Rows of the table with the corrections that were searched."""
    walls, channels, drift = found.walls, found.channels, found.drift
    values: dict[str, object] = {
        "delay_from": "walls" if config.delay else "kept",
        "path_bias_before_m": before.waveform.path_bias_m,
        "path_bias_m": found.capture.waveform.path_bias_m,
    }
    if found.applied("leakage"):
        values["leakage"] = str(found.corrections.leakage)
    if walls is not None:
        values["n_wall_echoes"] = len(walls.offsets_after_m)
        values["wall_rms_before_m"], values["wall_rms_m"] = walls.rms_m
        if found.applied("delay"):
            values["path_bias_sigma_m"] = walls.delay_sigma_m
        if found.applied("frame"):
            values |= {
                "prior_to_capture": walls.prior_to_capture.tolist(),
                "prior_rotation_sigma_rad": walls.rotation_sigma_rad.tolist(),
                "prior_translation_sigma_m": walls.translation_sigma_m.tolist(),
            }
    if channels is not None and found.applied("channels"):
        n = found.corrections.n_turns
        values |= {
            "channels": f"antenna index modulo {n}" if n else "offset of receiver from transmitter",
            "channel_phases_rad": channels.phases_rad.tolist(),
            "channel_phase_sigmas_rad": channels.sigma_rad.tolist(),
        }
    if drift is not None:
        values |= {"coherence_before": drift.coherence_before, "coherence": drift.coherence_before}
    if drift is not None and found.applied("positions"):
        values |= {
            "position_coefficients_m": drift.coefficients_m.tolist(),
            "position_sigma_m": drift.sigma_m,
            "coherence": drift.coherence_after,
        }
    return values
