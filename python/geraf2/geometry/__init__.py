"""Triangles, boxes and transforms: pure functions of arrays, used on either side of a scene."""
