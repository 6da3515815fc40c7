"""What each echo of a plastic body is of, by a network that has seen objects.

A glint alone does not show whether it is a front or a back face; its place among the others does:
along their normals, fronts lie around the middle of a body and back faces beyond it. The network
reads differences of positions and normals between all pairs of glints, by attention, so that it
does not depend on where the body stands nor how it is turned about the vertical. It was trained on
glints of drawn objects (`bench/python/train_faces.py`, docs/math/echoes.md#back-faces).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import as_file, files
from typing import NamedTuple

import numpy as np
from scipy.special import expit, softmax

from geraf2._types import AnyPath, Array, Bools, Floats
from geraf2.echoes.glint_set import Glints
from geraf2.io.checkpoint import load_checkpoint

WEIGHTS_NAME, WEIGHTS_KIND, WEIGHTS_VERSION = "faces.safetensors", "faces", 1
AT_ONCE = 96
"""Largest number of glints that the network reads together, drawn at random from a scan."""
LENGTH_M = 0.05
"""Unit of lengths between glints [m]."""


class FaceGuess(NamedTuple):
    """What each glint may be an echo of."""

    probability: Floats
    """Of a front face, a back face, both faces of a thin body, and clutter, (n, 4)."""
    thickness_m: Floats
    """Of the body behind the front, where it is not a front face alone, (n,) [m]."""

    def select(self, keep: Bools) -> "FaceGuess":
        """Guess of some of the glints, by mask."""
        return FaceGuess(self.probability[keep], self.thickness_m[keep])


@dataclass(frozen=True, eq=False)
class FaceNetwork:
    """Layers of attention with weights by the geometry of pairs."""

    arrays: Mapping[str, Array]
    """Weights by the names of torch."""

    def __call__(
        self, positions: Floats, normals: Floats, strengths: Floats
    ) -> tuple[Floats, Floats]:
        """Logits of the kinds, (n, 4), and log of the thickness [log m], (n,).

        positions: (n, 3) [m]. normals: (n, 3). strengths: above 0, (n,).
        """
        tokens = self._linear("inp", token_features(positions, normals, strengths))
        edges = _silu(self._linear("edge", pair_features(positions, normals)))
        for block in sorted({name.split(".")[1] for name in self.arrays if "blocks" in name}):
            tokens = self._block(f"blocks.{block}", tokens, edges)
        found = self._linear("out", self._norm("ln", tokens))
        return found[:, :4], found[:, 4]

    def _block(self, name: str, tokens: Array, edges: Array) -> Array:
        edge = self._linear(f"{name}.edge", edges).transpose(2, 0, 1)
        near, gates = np.split(edge, 2)  # of each head
        asked = self._linear(f"{name}.qkv", self._norm(f"{name}.ln1", tokens))
        query, key, value = asked.reshape(len(tokens), 3, len(near), -1).transpose(1, 2, 0, 3)
        scale = query.shape[2] ** -0.5
        shares = softmax(scale * query @ key.transpose(0, 2, 1) + near, axis=2)
        heads = np.concatenate([shares @ value, expit(gates) @ value], axis=2)
        tokens = tokens + self._linear(
            f"{name}.o", heads.transpose(1, 0, 2).reshape(len(tokens), -1)
        )
        hidden = _silu(self._linear(f"{name}.ff.0", self._norm(f"{name}.ln2", tokens)))
        return np.asarray(tokens + self._linear(f"{name}.ff.2", hidden))

    def _linear(self, name: str, values: Array) -> Array:
        return np.asarray(values @ self.arrays[f"{name}.weight"].T + self.arrays[f"{name}.bias"])

    def _norm(self, name: str, values: Array) -> Array:
        centred = values - values.mean(axis=1, keepdims=True)
        unit = centred / np.sqrt((centred**2).mean(axis=1, keepdims=True) + 1e-5)
        return np.asarray(unit * self.arrays[f"{name}.weight"] + self.arrays[f"{name}.bias"])


def guess_faces(glints: Glints, network: FaceNetwork | None = None) -> FaceGuess:
    """Guess what each glint is an echo of.

    Parameters
    ----------
    glints
        Of one scan, at their apparent positions.
    network
        That of the package when None.

    Returns
    -------
    FaceGuess
        Probabilities and thickness of each glint.
    """
    network = network or trained_network()
    order = np.random.default_rng(0).permutation(len(glints))
    logits, log_thickness = np.zeros((len(glints), 4)), np.zeros(len(glints))
    for own in np.array_split(order, max(1, -(-len(glints) // AT_ONCE))):
        logits[own], log_thickness[own] = network(
            glints.positions[own], glints.normals[own], glints.strengths[own]
        )
    return FaceGuess(softmax(logits, axis=1), np.exp(log_thickness))


def token_features(positions: Floats, normals: Floats, strengths: Floats) -> Array:
    """Of each glint, (n, 4): level, height and slope, and how many are read together."""
    level = np.log(strengths / strengths.max() + 1e-3)
    height = (positions[:, 2] - positions[:, 2].mean()) / LENGTH_M
    many = np.full(len(level), np.log(len(level)) - 4.0)
    return np.stack([level, normals[:, 2], height, many], axis=1).astype(np.float32)


def pair_features(positions: Floats, normals: Floats) -> Array:
    """Of each pair of glints, (n, n, 14): how far the second lies behind and beside the first."""
    normals = normals.astype(np.float32)
    step = ((positions[None] - positions[:, None]) / LENGTH_M).astype(np.float32)
    depth = np.einsum("ijk,ik->ij", step, normals)
    behind = np.einsum("ijk,jk->ij", step, normals)
    cosine, square = normals @ normals.T, np.einsum("ijk,ijk->ij", step, step)
    across2 = np.maximum(square - depth**2, 1e-6)
    offset = np.tanh(3.0 * (depth + behind))
    found = [np.tanh(k * v) for v in (depth, behind, depth + behind) for k in (1.0, 3.0)]
    found += [cosine, np.exp(-4.0 * across2), np.exp(-0.5 * across2)]
    found += [np.exp(-4.0 * square), np.exp(-0.5 * square), np.tanh(0.5 * np.sqrt(square))]
    found += [np.maximum(cosine, 0.0) * offset]
    found += [np.maximum(-cosine, 0.0) * np.tanh(depth - behind)]
    return np.stack(found, axis=2)


def _silu(values: Array) -> Array:
    return np.asarray(values * expit(values))


def load_network(path: AnyPath) -> FaceNetwork:
    """Read the file that `bench/python/train_faces.py` writes."""
    stored = load_checkpoint(path, kind=WEIGHTS_KIND, version=WEIGHTS_VERSION).arrays
    return FaceNetwork({name: array.astype(np.float32) for name, array in stored.items()})


@cache
def trained_network() -> FaceNetwork:
    """Network of the package, read once."""
    with as_file(files(__package__) / WEIGHTS_NAME) as path:
        return load_network(path)
