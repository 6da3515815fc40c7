"""geraf2 sees through boxes: metric surfaces from near-field FMCW radar scans.

The names of `__all__` are the public face: from a scan to a surface and its scores, and the kernels
beneath. Lengths in metres, bad input is a `UserError`. Each is loaded when it is first used.

>>> import geraf2
>>> result = geraf2.examples.small_run()  # or reconstruct(load_capture("scene"), (0.2, 0.2, 0.2))
>>> path = result.content.export("content.ply")
"""

from pathlib import Path as _Path

# What the stub imports for type checkers and editors is where each name is loaded from.
_LINES = _Path(__file__).with_suffix(".pyi").read_text(encoding="utf-8").splitlines()
_MODULES = {line.split()[3]: line.split()[1] for line in _LINES if line.startswith("from geraf2")}
__all__ = ["__version__", *_MODULES]  # noqa: PLE0604 - strings, every one


def __getattr__(name: str) -> object:
    if name in _MODULES:
        from importlib import import_module  # noqa: PLC0415 - as below

        module = _MODULES[name]
        found = import_module(f"{module}.{name}") if module == "geraf2" else None
        value = globals()[name] = found or getattr(import_module(module), name)
        return value
    if name != "__version__":
        msg = f"module {__name__!r} has no attribute {name!r}"
        raise AttributeError(msg)
    # Only when asked: importlib.metadata takes half of the time of `geraf2 --help`.
    from importlib.metadata import PackageNotFoundError, version  # noqa: PLC0415

    try:
        return version("geraf2")
    except PackageNotFoundError:  # a source tree that was never installed
        return "0.0.0"


def __dir__() -> list[str]:
    return [*globals(), *__all__]
