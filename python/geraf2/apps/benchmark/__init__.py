"""Tables of methods over simulated scenes: what to run, running it, and the pages that show it."""

from geraf2.apps.benchmark.costs import Cost, costs, listed
from geraf2.apps.benchmark.pages import write_pages
from geraf2.apps.benchmark.rows import Choice, Row, RowResult, rows_of
from geraf2.apps.benchmark.runner import Runner
from geraf2.apps.benchmark.suite import Case, Experiment, Method, Suite, load_suite

__all__ = [
    "Case",
    "Choice",
    "Cost",
    "Experiment",
    "Method",
    "Row",
    "RowResult",
    "Runner",
    "Suite",
    "costs",
    "listed",
    "load_suite",
    "rows_of",
    "write_pages",
]
