"""Isosurfaces and metrics, each with its definition."""
