"""Physical constants, SI units."""

SPEED_OF_LIGHT_M_PER_S = 299792458.0
"""Speed of light in vacuum [m/s]; exact by definition of the metre."""
