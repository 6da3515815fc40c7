"""Inputs of the completion, voxel by voxel in plain loops, from its description."""

import math

import numpy as np

FAR = 4.0  # [cm]


def _clip(value, limit=FAR):
    return min(max(value, -limit), limit)


def _gaussian(width, reach):
    """Weights at whole steps up to a reach, of sum 1; width and reach in voxels."""
    raw = [math.exp(-0.5 * (k / width) ** 2) for k in range(-reach, reach + 1)]
    return [w / sum(raw) for w in raw]


def _reflect(index, n):
    """Index of a field that is mirrored at its faces, the outermost voxel repeated."""
    index %= 2 * n
    return index if index < n else 2 * n - 1 - index


def _smoothed(field, voxel, width):
    """Weighted mean of the field around a voxel, to four widths."""
    weights = _gaussian(width, int(4.0 * width + 0.5))
    reach, total = len(weights) // 2, 0.0
    for i, u in enumerate(weights):
        for j, v in enumerate(weights):
            for k, w in enumerate(weights):
                steps = (i - reach, j - reach, k - reach)
                at = tuple(
                    _reflect(a + s, n) for a, s, n in zip(voxel, steps, field.shape, strict=True)
                )
                total += u * v * w * field[at]
    return total


def _slope(field, voxel, step):
    """Central differences, one-sided at a face."""
    slope = []
    for axis in range(3):
        low, high = list(voxel), list(voxel)
        low[axis] = max(voxel[axis] - 1, 0)
        high[axis] = min(voxel[axis] + 1, field.shape[axis] - 1)
        rise = field[tuple(high)] - field[tuple(low)]
        slope.append(rise / ((high[axis] - low[axis]) * step))
    return np.array(slope)


def _sum_around(points, values, voxel, shape, width, dimensions):
    """Sum of values under a Gaussian of height 1 about a voxel.

    Each point counts in the eight voxels around it, by trilinear shares. points in voxels.
    """
    weights = _gaussian(width, int(3.0 * width + 0.5))
    reach, total = len(weights) // 2, 0.0 * np.asarray(values[0])
    for point, value in zip(points, values, strict=True):
        low = np.floor(point).astype(int)
        for corner in np.ndindex(2, 2, 2):
            at, factor = low + corner, 1.0
            for axis in range(3):
                share = point[axis] - low[axis]
                off = at[axis] - voxel[axis]
                inside = 0 <= at[axis] < shape[axis] and abs(off) <= reach
                factor *= (share if corner[axis] else 1.0 - share) if inside else 0.0
                factor *= weights[off + reach] if inside else 0.0
            total = total + factor * value
    return (math.sqrt(2.0 * math.pi) * width) ** dimensions * total


def _margin(aperture, point, outwards):
    """How far inside an aperture the normal meets its plane [m]; -inf where it does not."""
    boresight, right, up = aperture.axes
    fall = float(outwards @ boresight)
    if abs(fall) <= 0.1:
        return -math.inf
    far = float((aperture.middle_m - point) @ boresight) / fall
    if far <= 0.0:
        return -math.inf
    away = point + far * outwards - aperture.middle_m
    half = aperture.half_m
    return min(half[0] - abs(float(away @ right)), half[1] - abs(float(away @ up)))


def inputs_of_voxel(sdf, points, apertures, outlines, voxel):
    """Inputs of one voxel, a triple, in the order of `geraf2.surfaces.completion.features`."""
    step, field = 100.0 * sdf.grid.spacing_m, 100.0 * sdf.values.astype(float)
    shape, origin = field.shape, 100.0 * np.asarray(sdf.grid.origin_m)
    normals, weights = points.normals, points.normal_weights
    glints, point = 100.0 * points.positions, origin + step * np.array(voxel)
    slope = _slope(field, voxel, step)
    steep = float(np.linalg.norm(slope))
    outwards = slope / max(steep, 1e-3)
    found = [field[voxel], steep, outwards[2]]
    found += [_smoothed(field, voxel, width / step) - field[voxel] for width in (0.5, 1.0, 2.0)]

    index = (glints - origin) / step
    moments = [
        w * np.array([1.0, *n, float(g @ n)])
        for w, n, g in zip(weights, normals, glints, strict=True)
    ]
    for width in (0.5, 1.0, 2.0, 4.0):
        total = _sum_around(index, moments, voxel, shape, width / step, 3)
        weight, mean = total[0], total[1:4] / (total[0] + 1e-4)
        along = (float(point @ total[1:4]) - total[4]) / (weight + 1e-4)
        found += [math.log(weight + 0.01), _clip(along), float(np.linalg.norm(mean))]
        found += [float(mean @ outwards), mean[2]]

    sight, passed = [], []
    for glint, normal, weight in zip(glints, normals, weights, strict=True):
        for k in range(19):  # every 4 mm from 6 to 78 mm
            sight.append((glint + (0.6 + 0.4 * k) * normal - origin) / step)
            passed.append(weight)
    for width in (0.4, 1.0):
        total = _sum_around(sight, passed, voxel, shape, width / step, 2)
        found.append(math.log(float(total) + 0.01))

    away = [float(np.linalg.norm(point - glint)) for glint in glints]
    order = sorted(range(len(glints)), key=away.__getitem__)
    found += [min(away[order[min(rank, len(order)) - 1]], FAR) for rank in (4, 16)]
    for n_near in (4, 12, 32):
        near = order[:n_near]
        aside = [float((point - glints[k]) @ normals[k]) for k in near]
        mean = sum(normals[k] for k in near) / len(near)
        found += [_clip(sum(aside) / len(near)), _clip(min(aside)), _clip(max(aside))]
        found += [float(np.linalg.norm(mean)), float(mean @ outwards)]

    margins, cosines = [-FAR], [-1.0]
    for aperture in apertures:
        margins.append(_clip(100.0 * _margin(aperture, 0.01 * point, outwards)))
        towards = aperture.middle_m - 0.01 * point
        cosines.append(float(towards @ outwards) / float(np.linalg.norm(towards)))
    found += [max(margins), max(cosines)]
    outside = -math.inf if outlines is None else outlines.free_distance(0.01 * point[None])[0]
    return np.array([*found, _clip(100.0 * outside)]), away[order[0]]
