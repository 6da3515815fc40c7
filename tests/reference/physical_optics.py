"""Physical-optics echo summed term by term in float64."""

import numpy as np

C = 299792458.0


def crossing(position, antenna, wall):
    """Excess path and transmission of the faces of one box between two points.

    Each of the six planes is intersected in turn and the hit tested against the face's extent.
    """
    center, half = np.asarray(wall.center_m), 0.5 * np.asarray(wall.size_m)
    ray = antenna - position
    length = np.linalg.norm(ray)
    excess, transmission = 0.0, 1.0
    for axis in range(3):
        for side in (-1, 1):
            if ray[axis] == 0:
                continue
            s = (center[axis] + side * half[axis] - position[axis]) / ray[axis]
            at = position + s * ray - center
            others = [k for k in range(3) if k != axis]
            if 0 < s < 1 and all(abs(at[k]) < half[k] for k in others):
                cos = abs(ray[axis]) / length
                inner = np.sqrt(wall.permittivity - 1 + cos**2)
                r = (cos - inner) / (cos + inner)
                excess += wall.thickness_m * (inner - cos)
                transmission *= 1 - r**2
    return excess, transmission


def triangle_mean(corner_phases):
    """Mean of exp(-j phase) over a triangle, by the centroids of 200^2 sub-triangles."""
    n = 200
    i, j = np.meshgrid(np.arange(n), np.arange(n), indexing="ij")
    total = 0.0
    for third, used in ((1.0, i + j < n), (2.0, i + j < n - 1)):
        u, v = (i[used] + third / 3) / n, (j[used] + third / 3) / n
        phases = np.stack([1 - u - v, u, v], axis=1) @ np.asarray(corner_phases)
        total += np.exp(-1j * phases).sum()
    return total / n**2


def echo(
    points,
    weights,
    tx,
    rx,
    waveform,
    *,
    normals=None,
    edges=None,
    shape="point",
    reflector="conductor",
    slab=None,
    slab_crossing=1.0,
    walls=(),
    boresight=None,
    exponent=0,
):
    """One antenna: sum over elements of the terms named in
    docs/math/echo-models.md#physical-optics-echo."""
    f = waveform.frequencies_hz
    k_mid = 2 * np.pi * 0.5 * (f[0] + f[-1]) / C
    signal = np.zeros(len(f), dtype=complex)
    for p, x in enumerate(points):
        r_t, r_r = np.linalg.norm(tx - x), np.linalg.norm(rx - x)
        to_tx, to_rx = (tx - x) / r_t, (rx - x) / r_r
        path = r_t + r_r + waveform.path_bias_m
        factor = weights[p] / (r_t * r_r)
        cos = 1.0
        if normals is not None:
            cos_t, cos_r = normals[p] @ to_tx, normals[p] @ to_rx
            if min(cos_t, cos_r) <= 0:
                continue
            cos = 0.5 * (cos_t + cos_r)
            factor *= cos
        faces = [(-1.0, 0.0)]  # reflection coefficient and further path
        if reflector == "slab":
            inner = np.sqrt(slab.permittivity - 1 + cos**2)
            r = (cos - inner) / (cos + inner)
            farther = -r * (1 - r**2) * slab_crossing**2
            faces = [(r, 0.0), (farther, 2 * slab.thickness_m * inner)]
        slope = -k_mid * (to_tx + to_rx)  # of the phase k d, along the surface
        if shape == "triangle":
            one, two = edges[p] @ slope
            factor *= triangle_mean([one, two, -one - two])
        elif shape == "rectangle":
            radians = np.outer(edges[p] @ slope, f / (0.5 * (f[0] + f[-1])))
            factor = factor * np.prod(np.sinc(radians / np.pi), axis=0)
            for r, to_end in ((r_t, to_tx), (r_r, to_rx)):  # second derivative of the range, /6
                for edge in edges[p]:
                    path += (edge @ edge - (edge @ to_end) ** 2) / (6 * r)
        factor *= (-(to_tx @ boresight) * -(to_rx @ boresight)) ** exponent if exponent else 1.0
        for wall in walls:
            for end in (tx, rx):
                excess, transmission = crossing(x, end, wall)
                path += excess
                factor *= transmission
        for coefficient, further in faces:
            signal += coefficient * factor * np.exp(-2j * np.pi * f * (path + further) / C)
    return 1j / (4 * np.pi) * signal
