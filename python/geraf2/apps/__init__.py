"""Applications. Each could be a package of its own; the instrument below imports none."""
