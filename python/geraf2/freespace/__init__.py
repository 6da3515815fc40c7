"""Where nothing is: silhouettes, surfaces that are tangent to their edges, caps."""
