"""Comparison of methods on simulated scenes: suites, runs, tables and pages."""

from geraf2.apps.benchmark.pages import write_pages
from geraf2.apps.benchmark.rows import Row, RowResult, rows_of
from geraf2.apps.benchmark.runner import Runner
from geraf2.apps.benchmark.suite import Case, Experiment, Method, Suite, load_suite

__all__ = [
    "Case",
    "Experiment",
    "Method",
    "Row",
    "RowResult",
    "Runner",
    "Suite",
    "load_suite",
    "rows_of",
    "write_pages",
]
