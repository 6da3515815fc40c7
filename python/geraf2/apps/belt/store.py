"""Results of a belt: a row for each parcel in parcels.sqlite and parcels.csv, and a page."""

import sqlite3
from collections.abc import Mapping
from contextlib import closing
from pathlib import Path
from typing import Any

from geraf2.errors import UserError
from geraf2.io.atomic import write_text_atomic
from geraf2.io.text import csv_rows

DATABASE_NAME, TABLE_NAME, PAGE_NAME = "parcels.sqlite", "parcels.csv", "parcels.html"
COLUMNS = {
    "parcel": "TEXT PRIMARY KEY",
    "position_m": "REAL",
    "length_m": "REAL",
    "state": "TEXT",
    "travel_percent": "REAL",
    "travel_sigma_percent": "REAL",
    "yaw_deg_per_m": "REAL",
    "typical_error_mm": "REAL",
    "not_seen_percent": "REAL",
    "f1_5mm": "REAL",
    "cpu_seconds": "REAL",
    "attempts": "INTEGER",
    "error": "TEXT",
    "run": "TEXT",
}
"""Columns of both tables; travel: true over recorded, less 1."""


class ParcelStore:
    """Rows of a folder.

    The database is whole at any moment. The CSV gets a line for each result, and is written again,
    in the order of the parcels, at the start and at the end.
    """

    def __init__(self, out: Path) -> None:
        self.out = out
        try:
            out.mkdir(parents=True, exist_ok=True)
            with self._open() as one, one:
                columns = ", ".join(f"{name} {kind}" for name, kind in COLUMNS.items())
                one.execute(f"CREATE TABLE IF NOT EXISTS parcels ({columns})")
        except sqlite3.Error as error:
            raise UserError(
                what=f"is no table of parcels: {error}",
                where=out / DATABASE_NAME,
                hint="choose another folder",
            ) from None
        self.write_table()

    def _open(self) -> "closing[sqlite3.Connection]":
        return closing(sqlite3.connect(self.out / DATABASE_NAME))

    def put(self, parcel: str, values: Mapping[str, Any]) -> None:
        """Set values of a row; with a state it is a line of the CSV."""
        names = list(values)
        marks = ", ".join("?" * (1 + len(names)))
        sets = ", ".join(f"{name} = excluded.{name}" for name in names)
        with self._open() as one, one:
            one.execute(
                f"INSERT INTO parcels (parcel, {', '.join(names)}) VALUES ({marks}) "
                f"ON CONFLICT (parcel) DO UPDATE SET {sets}",
                [parcel, *values.values()],
            )
            row = one.execute("SELECT * FROM parcels WHERE parcel = ?", [parcel]).fetchone()
        if "state" in values:
            with (self.out / TABLE_NAME).open("a", encoding="utf-8", newline="") as file:
                file.write(csv_rows([row]))

    def write_table(self) -> None:
        """Write the CSV from the database."""
        rows = [list(row.values()) for row in self.rows()]
        write_text_atomic(self.out / TABLE_NAME, csv_rows([list(COLUMNS), *rows]))

    def rows(self) -> list[dict[str, Any]]:
        """Return all rows, in the order of the parcels."""
        with self._open() as one:
            one.row_factory = sqlite3.Row
            found = one.execute("SELECT * FROM parcels ORDER BY parcel").fetchall()
        return [dict(row) for row in found]
