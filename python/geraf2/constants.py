"""Physical and mathematical constants, SI units."""

SPEED_OF_LIGHT_M_PER_S = 299792458.0
"""Speed of light in vacuum [m/s]; exact by definition of the metre."""
NORMAL_95 = 1.96
"""Half width of the 95 % interval of a normal distribution, in standard deviations."""
MAX_SPACING_WAVELENGTHS = 25.0
"""Largest spacing of a scan's antennas. A raster has a quarter wavelength to a few; 25 is beyond
any use, and 3 mm read as 3 m is 790."""
