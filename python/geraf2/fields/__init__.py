"""Fields over space; each beside its Config. Those that learn need torch: see `learned`."""

from geraf2.fields.nested_sets import BoxSolid, MeshSolid, NestedSets, Solid, SphereSolid
from geraf2.fields.sdf_grid import SdfGrid

__all__ = ["BoxSolid", "MeshSolid", "NestedSets", "SdfGrid", "Solid", "SphereSolid"]
