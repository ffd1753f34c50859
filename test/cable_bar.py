"""A bar of hexahedra along x, clamped at its begin, with cables."""

import softrobot_twin as st

LENGTH, WIDTH = 0.1, 0.02


def cable_bar(cables, effectors, along, young_modulus, **solver):
    """Makes it, with so many cells along it; more entries of `solver` may be given."""
    clamp = dict(box=dict(minimum=[-1e-6, -1, -1], maximum=[1e-6, 1, 1]))
    return st.build(
        name="bar", gravity=[0, 0, 0],
        body=dict(
            mesh=dict(box=dict(size=[LENGTH, WIDTH, WIDTH], cells=[along, 2, 2])),
            element="hexahedral", fixed=[clamp],
            material=dict(young_modulus=young_modulus, poisson_ratio=0.4, density=1000.0),
        ),
        cables=cables, effectors=effectors, solver=solver,
    )  # fmt: skip
