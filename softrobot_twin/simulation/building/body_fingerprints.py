"""Fingerprints of bodies: what a file that was made from a body is compared with when it is read."""

from __future__ import annotations

import hashlib

import numpy as np

from softrobot_twin.mechanics.laws import law_named
from softrobot_twin.simulation.building.body_materials import MaterialPart
from softrobot_twin.simulation.building.deformable_body import Body, in_mesh

# Digits of coordinates in fingerprints, as a share of the body's size: what files can tell apart.
DIGITS = 1.0e-7


def digest(*values) -> str:
    """Digest of strings and arrays."""
    made = hashlib.sha256()
    for value in values:
        made.update(value.encode() if isinstance(value, str) else np.ascontiguousarray(value))
    return made.hexdigest()


def rounded_places(body: Body, points: np.ndarray) -> np.ndarray:
    """Points in mesh coordinates [m] as integers, equal where files cannot tell them apart."""
    # Half a digit is added: most coordinates are round numbers, and stay clear of a limit.
    return np.floor(points / (DIGITS * _size(body)) + 0.5).astype(np.int64)


def _size(body: Body) -> float:
    positions = in_mesh(body.entry, body.mesh.node_positions)
    return float(np.linalg.norm(np.ptp(positions, axis=0)))


def fingerprints_of(body: Body) -> dict[str, str]:
    """Digests of a body's mesh and material; its placement in the world is in neither."""
    materials = [
        (part.law, repr((*_constants(part), part.density)),
         np.arange(body.mesh.cell_count) if part.cells is None else part.cells)
        for part in body.materials
    ]  # fmt: skip
    places = rounded_places(body, in_mesh(body.entry, body.mesh.node_positions))
    bearing = body.entry.element + (" in patches" if body.entry.has_patches else "")
    return {
        "mesh": digest(f"{_size(body):.6e}", places, body.mesh.cells, bearing),
        "material": digest(*(value for part in materials for value in part)),
    }


def _constants(part: MaterialPart) -> tuple:
    """What the stiffness of a material follows from: E and ν, or the constants of its law."""
    if law_named(part.law).own is None:
        return part.young_modulus, part.poisson_ratio
    return part.law_parameters
