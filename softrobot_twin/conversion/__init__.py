"""Scenes of SOFA, in Python or XML, as scenes of this package.

A recording keeps the tree of nodes and components of a file, rules by the name of a component write
entries from them, and a report lists what has no counterpart.
"""
