"""Signed distance fields over space. Learned fields, which need torch, are in `learned`."""

from geraf2.fields.nested_sets import BoxSolid, NestedSets, Solid, SphereSolid
from geraf2.fields.sdf_grid import SdfGrid

__all__ = ["BoxSolid", "NestedSets", "SdfGrid", "Solid", "SphereSolid"]
