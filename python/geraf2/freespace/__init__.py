"""Where nothing is: silhouettes, and surfaces that are tangent to their edges."""
