"""Answers about what lies in a box: parts and their sizes, CAD models, changes."""

from geraf2.inspection.bodies import Body, BodyReport, Measured
from geraf2.inspection.comparison import Comparison
from geraf2.inspection.deviation import Deviation, Region
from geraf2.inspection.matching import Match
from geraf2.inspection.models import CadModel
from geraf2.inspection.registration import Placement
from geraf2.inspection.result import Inspection, ModelReport

__all__ = [
    "Body",
    "BodyReport",
    "CadModel",
    "Comparison",
    "Deviation",
    "Inspection",
    "Match",
    "Measured",
    "ModelReport",
    "Placement",
    "Region",
]
