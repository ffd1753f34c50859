"""Slips of the unit, found before anything moves: millimetres read as metres, kPa as Pa."""

from __future__ import annotations

import numpy as np

from softrobot_twin.simulation.model import Model

SIZE_RANGE = (0.002, 5.0)
"""Soft robots are between so small and so large [m]."""
DENSITY_RANGE = (20.0, 10_000.0)
"""From foam to steel [kg/m³]."""
YOUNG_RANGE = (1.0e3, 3.0e11)
"""From jelly to steel [Pa]."""
LOCKING_RATIO = 0.48
"""Linear tetrahedra that hardly change their volume can hardly change their shape."""
SAG_SHARE = 0.5
"""A body that sags by more than this share of its size cannot be what was meant."""


def unit_slips(model: Model) -> list[str]:
    """Warn of what looks like the wrong unit.

    Args:
        model: The built scene; its factorization is used and left undefined.

    Returns:
        A sentence for each suspicion; empty when all looks well.
    """
    notes = [note for body in model.bodies for note in _odd_values(body)]
    if not all(body.is_held for body in model.bodies) or model.nodes.free_node_count == 0:
        return notes
    sag = linear_sag(model)
    if not sag <= SAG_SHARE * model.nodes.size:
        notes.append(
            f"under gravity the body would sag by {sag:.3g} m, its size is {model.nodes.size:.3g} "
            "m: check the units of young_modulus, density and gravity, and what is fixed"
        )
    return notes


def _odd_values(body) -> list[str]:
    material, key = body.entry.material, body.key
    notes = []
    if body.entry.element == "linear" and material.poisson_ratio > LOCKING_RATIO:
        notes.append(
            f"{key}.material.poisson_ratio = {material.poisson_ratio:g} with {key}.element = "
            f"linear: above {LOCKING_RATIO:g} linear tetrahedra lock, the body is far too stiff; "
            "use element: quadratic"
        )
    for name, value, (low, high), unit, hint in (
        (f"{key}.mesh size", body.size, SIZE_RANGE, "m",
         "is the mesh in millimetres? then give scale: 0.001"),
        (f"{key}.material.density", material.density, DENSITY_RANGE, "kg/m³",
         "silicone has about 1070 kg/m³"),
        (f"{key}.material.young_modulus", material.young_modulus, YOUNG_RANGE, "Pa",
         "silicone has some 1e4 to 1e6 Pa"),
    ):  # fmt: skip
        if not low <= value <= high:
            notes.append(
                f"{name} = {value:.4g} {unit} is outside {low:g} to {high:g} {unit}: {hint}"
            )
    return notes


def linear_sag(model: Model) -> float:
    """Largest displacement of deformable bodies under their weight, by one linear solve [m]."""
    nodes, factorization = model.nodes, model.factorization
    forces = np.zeros((nodes.free_node_count, 3))
    factorization.clear()
    for term in model.forces:
        term.add(nodes.rest_positions, forces, factorization.storage, True)
    if not forces.any() or not factorization.factor():
        return 0.0
    soft = sum(int((~body.fixed).sum()) for body in model.bodies)
    moves = np.linalg.norm(factorization.solve(forces), axis=1)
    return float(moves[:soft].max(initial=0.0))
