"""Text files, with one clear line for what cannot be read."""

from pathlib import Path

from geraf2.errors import UserError


def read_text(path: Path) -> str:
    """UTF-8 text of a file; UserError where it cannot be read."""
    try:
        return path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise UserError(what="no such file", where=path) from None
    except UnicodeDecodeError:
        raise UserError(what="is not text", where=path) from None
    except OSError as error:
        raise UserError(what=f"cannot be read: {error.strerror}", where=path) from error


def read_lines(path: Path) -> list[str]:
    """Lines of a text file."""
    return read_text(path).splitlines()
