"""The network of faces, glint by glint in plain loops, from its description; slow."""

import math

import numpy as np


def pair(one, other):
    """Numbers of a pair; each is a position [m] and a normal."""
    step = [(b - a) / 0.05 for a, b in zip(one[0], other[0], strict=True)]
    depth, behind = np.dot(step, one[1]), np.dot(step, other[1])
    cosine, distance = np.dot(one[1], other[1]), math.sqrt(np.dot(step, step))
    across2 = max(distance**2 - depth**2, 1e-6)
    return [
        *(math.tanh(k * depth) for k in (1, 3)),
        *(math.tanh(k * behind) for k in (1, 3)),
        *(math.tanh(k * (depth + behind)) for k in (1, 3)),
        cosine,
        *(math.exp(-k * across2) for k in (4.0, 0.5)),
        *(math.exp(-k * distance**2) for k in (4.0, 0.5)),
        math.tanh(0.5 * distance),
        max(cosine, 0.0) * math.tanh(3.0 * (depth + behind)),
        max(-cosine, 0.0) * math.tanh(depth - behind),
    ]


def linear(weights, name, vector):
    return weights[f"{name}.weight"] @ np.asarray(vector) + weights[f"{name}.bias"]


def norm(weights, name, vector):
    spread = math.sqrt(np.var(vector) + 1e-5)
    unit = (vector - np.mean(vector)) / spread
    return unit * weights[f"{name}.weight"] + weights[f"{name}.bias"]


def silu(vector):
    return np.array([v / (1.0 + math.exp(-v)) for v in vector])


def run(weights, positions, normals, strengths):
    """Logits of the kinds and log of the thickness [log m], (n, 5)."""
    n, heads = len(positions), 4
    mean_z = sum(p[2] for p in positions) / n
    tokens = [
        linear(
            weights,
            "inp",
            [math.log(s / max(strengths) + 1e-3), m[2], (p[2] - mean_z) / 0.05, math.log(n) - 4.0],
        )
        for p, m, s in zip(positions, normals, strengths, strict=True)
    ]
    glints = list(zip(positions, normals, strict=True))
    edges = [[silu(linear(weights, "edge", pair(a, b))) for b in glints] for a in glints]
    size = len(tokens[0]) // heads
    for name in (f"blocks.{k}" for k in range(4)):
        asked = [linear(weights, f"{name}.qkv", norm(weights, f"{name}.ln1", t)) for t in tokens]
        query, key, value = (
            [a[k * heads * size : (k + 1) * heads * size].reshape(heads, size) for a in asked]
            for k in range(3)
        )
        after = []
        for i in range(n):
            edge = [linear(weights, f"{name}.edge", e) for e in edges[i]]
            joined = []
            for h in range(heads):
                score = [query[i][h] @ key[j][h] / math.sqrt(size) + edge[j][h] for j in range(n)]
                shares = [math.exp(s - max(score)) for s in score]
                gates = [1.0 / (1.0 + math.exp(-edge[j][heads + h])) for j in range(n)]
                joined.append(sum(w * value[j][h] for j, w in enumerate(shares)) / sum(shares))
                joined.append(sum(g * value[j][h] for j, g in enumerate(gates)))
            token = tokens[i] + linear(weights, f"{name}.o", np.concatenate(joined))
            hidden = silu(linear(weights, f"{name}.ff.0", norm(weights, f"{name}.ln2", token)))
            after.append(token + linear(weights, f"{name}.ff.2", hidden))
        tokens = after
    return np.array([linear(weights, "out", norm(weights, "ln", t)) for t in tokens])
