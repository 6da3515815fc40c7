"""Files in and out: scene container, meshes, importers. Knows no physics."""
