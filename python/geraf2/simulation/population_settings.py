"""Distributions that the population of random objects and scans is drawn from."""

from dataclasses import dataclass

Range = tuple[float, float]
"""Lower and upper bound of a uniform draw."""
Counts = tuple[int, int]
"""Lower and upper bound of a uniform whole number, both included."""
Weights = tuple[tuple[str, float], ...]
"""Choices with their probabilities, which add up to 1."""


@dataclass(frozen=True, kw_only=True)
class Population:
    """Distributions of objects, boxes, scans and worlds; lengths in metres.

    A pair of numbers is the range of a uniform draw. A change of any field, or of the order of the
    draws, is another population: raise `POPULATION_VERSION`.

    >>> from geraf2.simulation.population_settings import Population
    >>> Population().size_m[0]  # of one body [m]
    (0.05, 0.18)
    """

    bodies: Weights = (("1", 0.7), ("2", 0.2), ("3", 0.1))
    """Number of bodies."""
    size_m: tuple[Range, Range, Range] = ((0.05, 0.18), (0.08, 0.18), (0.11, 0.18))
    """Largest extent of all bodies together: of one, two and three [m]."""
    body_share: tuple[Range, Range, Range] = ((1.0, 1.0), (0.45, 0.65), (0.35, 0.5))
    """Extent of a body over that of all: of one, two and three bodies."""
    gap_m: Range = (0.004, 0.02)
    """Distance of neighbouring bodies [m]."""
    standing: float = 0.5
    """Probability that the bodies stand on the floor; else they float."""
    plastic: float = 0.25
    """Probability that the object is plastic; else it is metal."""
    permittivity: Range = (2.5, 3.3)
    """Relative permittivity of plastic."""
    loss_tangent: Range = (0.004, 0.015)
    """Loss tangent of plastic."""

    first_part: Weights = (
        ("capsule", 0.15),
        ("ball", 0.15),
        ("box", 0.2),
        ("torus", 0.1),
        ("lathe", 0.2),
        ("plate", 0.07),
        ("wire", 0.03),
        ("pipe", 0.1),
    )
    """Kind of the part that a body begins with."""
    further_part: Weights = (
        ("capsule", 0.25),
        ("ball", 0.05),
        ("box", 0.12),
        ("torus", 0.15),
        ("lathe", 0.1),
        ("plate", 0.1),
        ("wire", 0.15),
        ("pipe", 0.08),
    )
    """Kind of each part that is joined to it."""
    n_further_parts: Counts = (0, 4)
    """Number of these."""
    further_share: Range = (0.35, 0.8)
    """Size of such a part over that of the first."""
    fillet_share: Range = (0.01, 0.08)
    """Radius of the fillets between parts over the size of the first."""
    width_share: Range = (0.2, 0.6)
    """Width of capsules, and of lathe profiles at each height, over their length."""
    side_share: Range = (0.35, 1.0)
    """Each side of boxes and plates, and each axis of ellipsoids, over the size of the part."""
    rounding_share: Range = (0.1, 0.6)
    """Radius of a box's edges over its shortest half side."""
    ring_share: Range = (0.06, 0.16)
    """Radius of a torus' tube over its size."""
    flattening: Range = (0.6, 1.0)
    """Short over long axis of a torus."""
    thickness_m: Range = (0.002, 0.005)
    """Thickness of plates and of the walls of pipes [m]."""
    wire_radius_m: Range = (0.0012, 0.003)
    """Radius of wires [m]."""

    box_side_m: Range = (0.14, 0.40)
    """Sides of the box, as long as the content needs at least [m]."""
    clearance_m: Range = (0.012, 0.04)
    """Least distance of the content to the walls' inner faces, the floor not counted [m]."""
    foot_gap_m: float = 0.0003
    """Distance of a standing object to the floor's inner face [m]."""
    wall_thickness_m: Range = (0.003, 0.006)
    """Thickness of the walls [m]."""
    wall_permittivity: Range = (1.4, 1.9)
    """Relative permittivity of the walls."""

    n_planes: Counts = (6, 36)
    """Number of planes, uniform in its logarithm."""
    scan_kind: Weights = (("ring", 0.5), ("raised", 0.3), ("two rings", 0.2))
    """Planes in one ring; some of them above it; or half of them in a second, raised ring."""
    raised_deg: Range = (20.0, 60.0)
    """Elevation of raised planes, and of a second ring [degrees]."""
    n_raised: Counts = (1, 4)
    """Number of raised planes."""
    top_plane: float = 0.3
    """Probability that one of the raised planes is above the box."""
    spacing_m: tuple[float, ...] = (0.003, 0.004, 0.005)
    """Distances of neighbouring antennas, equally probable [m]."""
    aperture_width_m: Range = (0.08, 0.16)
    """Width of a plane [m]."""
    aperture_height_m: Range = (0.08, 0.25)
    """Height of a plane [m]."""
    standoff_m: Range = (0.30, 0.50)
    """Distance of planes to the axis, at least so that they stay clear of the box [m]."""
    box_distance_m: float = 0.04
    """Least distance of a plane's centre to the sphere about the box [m]."""
    radar: Weights = (("64 samples", 0.55), ("AWR1843", 0.2), ("4 GHz", 0.15), ("60 GHz", 0.1))
    """Chirp of the radar. Most have 64 samples: a scan then costs a quarter to simulate, so that it
    keeps its planes and its spacing."""
    snr_db: Range = (10.0, 25.0)
    """Signal-to-noise ratio [dB]."""
    clutter: float = 0.2
    """Probability of weak scatterers around the object."""
    clutter_share: Range = (0.01, 0.1)
    """Their energy over that of the object."""
    world: Weights = (("none", 0.3), ("plausible", 0.5), ("hard", 0.2))
    """Level of the world's effects but for waves, second bounces and plastic."""
    waves: float = 0.1
    """Probability of far walls as waves and of second bounces."""
    budget_s: float = 40.0
    """Estimated CPU time of a simulation, to which planes and antennas are reduced [s]."""
    waves_budget_s: float = 50.0
    """The same where walls send waves [s]."""


POPULATION = Population()
"""The population that the project decides by."""
POPULATION_VERSION = 2
"""Raised when a seed gives another object or another scan."""
