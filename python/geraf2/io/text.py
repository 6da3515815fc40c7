"""Text files and JSON objects, with one clear line for what cannot be read."""

import codecs
import csv
import io
import json
import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from geraf2.errors import UserError
from geraf2.io.file_kinds import refuse_other_kind
from geraf2.io.objects import read_bytes
from geraf2.io.regular import RECORD_BYTES, TEXT_BYTES

NOT_DETERMINED = "not determined"
"""Text in place of a value that a scan does not show."""


def read_text(path: Path, most: int = TEXT_BYTES) -> str:
    """Text of a file of at most so many bytes, UTF-8, or UTF-16 with its mark; else UserError."""
    refuse_other_kind(path)
    try:
        data = read_bytes(path, most)
        is_wide = data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
        text = data.decode("utf-16" if is_wide else "utf-8-sig")
        return text.replace("\r\n", "\n").replace("\r", "\n")
    except FileNotFoundError:
        raise UserError(what="no such file", where=path) from None
    except IsADirectoryError:
        raise UserError(what="is a folder", where=path, expected="a file") from None
    except UnicodeDecodeError as error:
        raise UserError(what=f"is not text in UTF-8 (byte {error.start})", where=path) from None
    except OSError as error:
        raise UserError(what=f"cannot be read: {error.strerror}", where=path) from error


def read_lines(path: Path) -> list[str]:
    """Lines of a text file."""
    return read_text(path).splitlines()


def parse_json(text: str | bytes) -> Any:
    """Value of JSON text; ValueError for what is none, nested too deep, or no finite number."""
    try:
        return json.loads(text, parse_float=_finite_number, parse_constant=_finite_number)
    except RecursionError:
        msg = "tables and lists are nested too deep"
        raise ValueError(msg) from None


def _finite_number(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        msg = f"{text} is no finite number"
        raise ValueError(msg)
    return value


def read_object(path: Path) -> dict[str, Any]:
    """Object of a JSON file; UserError for anything else."""
    try:
        values = parse_json(read_text(path, RECORD_BYTES))
    except ValueError as error:
        raise UserError(what=f"is not valid JSON: {error}", where=path) from None
    if not isinstance(values, dict):
        raise UserError(what="is no JSON object", where=path, got=type(values).__name__)
    return values


def csv_text(head: Sequence[Any], rows: Iterable[Sequence[Any]]) -> str:
    """Text of a CSV file with a line of column names."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([head, *rows])
    return text.getvalue()


def interval_text(
    value: float, half: float | None, *, digits: int = 1, scale: float | None = None, unit: str = ""
) -> str:
    """Value ± half of its interval, with its unit; "not determined" if that is larger.

    half: None where the interval is withdrawn. scale: size of the quantity in the unit of the
    value, which it is when None; that of a position is the size of the thing.
    """
    if half is None:
        return f"{value:z.{digits}f}{unit}"
    if not half <= (abs(value) if scale is None else scale):
        return NOT_DETERMINED
    return f"{value:z.{digits}f} ± {half:.{digits}f}{unit}"
