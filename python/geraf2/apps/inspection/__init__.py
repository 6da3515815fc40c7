"""Inspection of the content of a box: parts and their sizes, CAD models, changes."""

from geraf2.apps.inspection.bodies import Body, BodyReport
from geraf2.apps.inspection.comparison import Change, Comparison
from geraf2.apps.inspection.deviation import Deviation, Region
from geraf2.apps.inspection.matching import Match
from geraf2.apps.inspection.material import Material, Measured
from geraf2.apps.inspection.models import CadModel
from geraf2.apps.inspection.registration import Placement
from geraf2.apps.inspection.result import Inspection, ModelReport

__all__ = [
    "Body",
    "BodyReport",
    "CadModel",
    "Change",
    "Comparison",
    "Deviation",
    "Inspection",
    "Match",
    "Material",
    "Measured",
    "ModelReport",
    "Placement",
    "Region",
]
