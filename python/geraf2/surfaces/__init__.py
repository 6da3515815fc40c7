"""From glints to the surface: linear signed-distance fit, isosurface, meshes, expected errors."""

from geraf2.surfaces.fit import FitConfig, fit_sdf

__all__ = ["FitConfig", "fit_sdf"]
