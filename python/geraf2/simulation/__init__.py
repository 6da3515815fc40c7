"""Physical-optics captures of meshes in nested boxes."""
