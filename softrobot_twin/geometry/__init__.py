"""Meshes and their surfaces, shapes, point location, and contact detection between them."""
