"""Heat maps, glints, and the linear signed-distance fit."""
