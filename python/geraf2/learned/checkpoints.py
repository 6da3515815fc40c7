"""Checkpoints of a training, bit-identical."""

from collections.abc import Iterator
from dataclasses import asdict
from typing import Any

import torch
from numpy.typing import NDArray
from torch import Tensor

from geraf2.errors import UserError
from geraf2.io.checkpoint import Checkpoint
from geraf2.io.toml import from_table
from geraf2.learned.config import PaperConfig
from geraf2.learned.fields import LearnedSdfGrid
from geraf2.learned.model import PaperModel
from geraf2.learned.optimiser import make_optimiser
from geraf2.learned.trainer import PaperTrainer

KIND = "paper"
VERSION = 3
"""Version of the layout below; raised when it changes."""
_PARTS = ("model", "optimiser", "generator")


def save_state(trainer: PaperTrainer, key: str) -> Checkpoint:
    """Complete state of a training. `key` identifies its settings and scene."""
    arrays = model_arrays(trainer.model)
    stored = trainer.optimiser.state_dict()
    for group in stored["param_groups"]:
        for name, value in stored["state"].get(group["params"][0], {}).items():
            arrays[f"optimiser.{group['name']}.{name}"] = value.cpu().numpy()
    arrays["generator"] = trainer.draws.generator.get_state().numpy()
    header = {
        "stage": trainer.stages.stage,
        "step_in_stage": trainer.stages.step,
        "key": key,
        "config": asdict(trainer.config),
    }
    return Checkpoint(kind=KIND, version=VERSION, arrays=arrays, header=header)


def load_state(trainer: PaperTrainer, checkpoint: Checkpoint, key: str, where: object) -> None:
    """Restore a checkpoint into a trainer of the same scene and settings, on any device."""
    header, arrays = checkpoint.header, checkpoint.arrays
    if header.get("key") != key:
        raise UserError(
            what="is a checkpoint of another scene or of other settings",
            where=where,
            hint="repeat the settings of the run, or start again without --resume",
        )
    load_model(trainer.model, arrays, where)
    trainer.stages.stage, trainer.stages.step = int(header["stage"]), int(header["step_in_stage"])
    trainer.optimiser = make_optimiser(trainer.model, trainer.config, trainer.stages.current)
    stored = trainer.optimiser.state_dict()
    for group in stored["param_groups"]:
        prefix = f"optimiser.{group['name']}."
        state = {
            name.removeprefix(prefix): torch.from_numpy(values)
            for name, values in arrays.items()
            if name.startswith(prefix)
        }
        if state:
            stored["state"][group["params"][0]] = state
    trainer.optimiser.load_state_dict(stored)
    trainer.draws.generator.set_state(torch.from_numpy(arrays["generator"]))


def model_arrays(model: PaperModel) -> dict[str, NDArray[Any]]:
    """Parameters and open octaves by name."""
    return {f"model.{name}": p.detach().cpu().numpy() for name, p in _stored_tensors(model)}


def load_model(model: PaperModel, arrays: dict[str, NDArray[Any]], where: object) -> None:
    """Set parameters, open octaves, and the resolution of the distance's grid."""
    if isinstance(model.sdf, LearnedSdfGrid) and "model.sdf.values" in arrays:
        n_per_side = arrays["model.sdf.values"].shape[0]
        if n_per_side > model.sdf.grid.shape[0]:
            model.sdf.upsample(n_per_side)
    known = model_arrays(model).keys()
    unknown = [
        name
        for name in sorted(arrays)
        if name.split(".")[0] not in _PARTS or (name.startswith("model.") and name not in known)
    ]
    if unknown:
        raise UserError(
            what=f"is a checkpoint of other networks: it has {', '.join(unknown)[:200]}",
            where=where,
            expected=f"{len(known)} tensors of this model",
        )
    with torch.no_grad():
        for name, parameter in _stored_tensors(model):
            stored = arrays.get(f"model.{name}")
            if stored is None or stored.shape != tuple(parameter.shape):
                raise UserError(
                    what=f"is a checkpoint of other networks: {name} does not fit",
                    where=where,
                    expected=tuple(parameter.shape),
                    got=None if stored is None else stored.shape,
                )
            parameter.copy_(torch.from_numpy(stored))


def _stored_tensors(model: PaperModel) -> Iterator[tuple[str, Tensor]]:
    """Yield the stored tensors of a model by name: parameters, and a network's open octaves."""
    yield from model.named_parameters()
    yield from model.named_buffers()


def config_of(header: dict[str, Any], where: object) -> PaperConfig:
    """Return the settings of a checkpoint; UserError names an unknown key."""
    return from_table(header.get("config"), PaperConfig, f"{where}: settings")
