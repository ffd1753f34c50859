"""Builds terms from a scene and steps them: Coevoet 2017, eq. 5-15."""
