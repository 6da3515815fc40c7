"""Free space and unseen surfaces: silhouettes, their tangent points."""
