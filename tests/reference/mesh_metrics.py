"""Slow twin of the mesh metrics, written from their definitions with plain loops."""

import math


def nearest_distances(points, others):
    """min over o of |p - o| for each p."""
    return [min(math.dist(p, o) for o in others) for p in points]


def chamfer(first, second):
    """Mean squared nearest distance, both directions, summed [m^2]."""
    there = nearest_distances(first, second)
    back = nearest_distances(second, first)
    return sum(d * d for d in there) / len(there) + sum(d * d for d in back) / len(back)


def f1(mesh_points, truth_points, tau):
    """Precision, recall and their harmonic mean at threshold tau [m]."""
    matched_mesh = [d < tau for d in nearest_distances(mesh_points, truth_points)]
    matched_truth = [d < tau for d in nearest_distances(truth_points, mesh_points)]
    precision = sum(matched_mesh) / len(matched_mesh)
    recall = sum(matched_truth) / len(matched_truth)
    if precision + recall == 0:
        return precision, recall, 0.0
    return precision, recall, 2 * precision * recall / (precision + recall)
