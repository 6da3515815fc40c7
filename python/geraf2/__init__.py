"""geraf2 sees through boxes: metric surfaces from near-field FMCW radar scans."""

from importlib.metadata import PackageNotFoundError, version

try:
    __version__ = version("geraf2")
except PackageNotFoundError:  # a source tree that was never installed
    __version__ = "0.0.0"

__all__ = ["__version__"]
