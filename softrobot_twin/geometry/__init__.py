"""Tetrahedral meshes and their surfaces: reading, mending, quality, locating points, regions."""
