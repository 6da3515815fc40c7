"""Fields over space; each beside its Config."""

from geraf2.fields.sdf_grid import SdfGrid

__all__ = ["SdfGrid"]
