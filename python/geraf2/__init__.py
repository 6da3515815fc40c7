"""geraf2 sees through boxes: metric surfaces from near-field FMCW radar scans."""

__all__ = ["__version__"]


def __getattr__(name: str) -> str:
    if name != "__version__":
        msg = f"module {__name__!r} has no attribute {name!r}"
        raise AttributeError(msg)
    # Only when asked: importlib.metadata takes half of the time of `geraf2 --help`.
    from importlib.metadata import PackageNotFoundError, version  # noqa: PLC0415

    try:
        return version("geraf2")
    except PackageNotFoundError:  # a source tree that was never installed
        return "0.0.0"
