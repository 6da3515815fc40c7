"""Where nothing is: silhouettes, absent echoes, tangent surfaces, caps."""
