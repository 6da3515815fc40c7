"""geraf2 sees through boxes: metric surfaces from near-field FMCW radar scans.

The names of `__all__` are the public interface: from a scan to a surface and its scores, and the
kernels beneath. Lengths in metres, bad input is a `UserError`. Each is loaded when first used.

>>> import geraf2
>>> result = geraf2.examples.small_run()  # or reconstruct(load_capture("scene"), (0.2, 0.2, 0.2))
>>> path = result.content.export("content.ply")
"""

import lazy_loader

# Each name is loaded from where the stub imports it.
_load, _, _names = lazy_loader.attach_stub(__name__, __file__)
__all__ = ["__version__", *_names]  # noqa: PLE0604 - strings, every one


def __getattr__(name: str) -> object:
    if name != "__version__":
        return _load(name)
    # Only when asked: importlib.metadata takes half of the time of `geraf2 --help`.
    from importlib.metadata import PackageNotFoundError, version  # noqa: PLC0415

    try:
        return version("geraf2")
    except PackageNotFoundError:  # a source tree that was never installed
        return "0.0.0"


def __dir__() -> list[str]:
    return __all__
