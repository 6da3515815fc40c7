"""Triangles, boxes and transforms: pure functions of arrays, without scenes."""
