"""Samples of the surface of a finished run."""

from dataclasses import replace
from pathlib import Path

from geraf2.echoes import Glints
from geraf2.errors import UserError
from geraf2.freespace.silhouettes import Silhouettes
from geraf2.io.mesh import TriangleMesh
from geraf2.io.run_folder import GLINTS_NAME, SILHOUETTES_NAME, RunFolder
from geraf2.pipeline.presets import BestPreset, FastPreset, PresetConfig
from geraf2.pipeline.stages.calibration import common_sigma_m
from geraf2.pipeline.stages.direct import content_fit
from geraf2.surfaces.error_field import sample_surface
from geraf2.surfaces.fit import Evidence, FitConfig
from geraf2.surfaces.refinement import evidence_of
from geraf2.surfaces.samples import SurfaceSamples


def require_samples(config: PresetConfig, n_samples: int) -> None:
    """Raise UserError for a single sample, or for a preset that states no errors."""
    if n_samples < 2:
        raise UserError(what="samples must be at least 2", got=n_samples)
    if not isinstance(config, FastPreset | BestPreset):
        raise UserError(
            what=f"preset {config.preset!r} states no errors to draw samples from",
            expected="best or fast",
        )


def samples_of_run(
    run: RunFolder,
    mesh: TriangleMesh,
    config: PresetConfig,
    *,
    n_samples: int,
    seed: int = 0,
) -> SurfaceSamples:
    """Draw surfaces that the scan of a finished run allows.

    mesh: its content. config: constants of its preset.

    Raises UserError if the run states no errors.
    """
    require_samples(config, n_samples)
    evidence, _ = evidence_of_run(run, config)
    samples = sample_surface(mesh, evidence, n_samples=n_samples, seed=seed)
    return replace(samples, mesh=mesh)  # keeps the expected error that the run wrote


def evidence_of_run(run: RunFolder, config: PresetConfig) -> tuple[Evidence, FitConfig]:
    """Load the data of a run's fit, and its settings."""
    if isinstance(config, FastPreset):
        glints = Glints.load(_file(run, GLINTS_NAME))
        evidence = Evidence(glints=glints, common_sigma_m=common_sigma_m(run))
        return evidence, content_fit(run, config.fit)
    assert isinstance(config, BestPreset)  # see require_samples
    shadows = run.find_file(SILHOUETTES_NAME)
    outlines = Silhouettes.load(shadows) if shadows is not None else None
    glints = Glints.load(_file(run, GLINTS_NAME))
    evidence = evidence_of(glints, outlines, config.refine, common_sigma_m(run))
    return evidence, content_fit(run, config.refine.fit)


def _file(run: RunFolder, name: str) -> Path:
    path = run.find_file(name)
    if path is None:
        raise UserError(
            what=f"the run has no {name} to draw samples from",
            where=run.path,
            hint="repeat it with 'geraf2 reconstruct --overwrite'",
        )
    return path
