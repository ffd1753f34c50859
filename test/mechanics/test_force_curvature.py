"""The third derivative of the energy along a direction, of elements with every law and of other terms."""

import numpy as np
import pytest

from softrobot_twin.mechanics.element_kinds import element_named
from softrobot_twin.mechanics.elements import Elements
from softrobot_twin.mechanics.force_term import ForceTerm
from softrobot_twin.mechanics.gravity import Gravity
from softrobot_twin.mechanics.laws import law_named
from test.builder import builder

YOUNG, POISSON, SEED = 2.0e5, 0.45, 11
SMALL = (0.02, 0.02, 0.02)


@builder
def deformed(block, bind, /, law, element="linear"):
    """Makes elements of a law in a turned and stretched state, and a smooth direction."""
    mesh = element_named(element).make_mesh(block(size=SMALL, cells=(2, 2, 1)))
    (strained,) = mesh.strained_blocks()
    parameters = law_named(law).of_moduli(YOUNG, POISSON)
    bound = bind(
        (lambda part, free, _: Elements(part, free, parameters), strained.mesh, YOUNG, POISSON),
        fixed=[0],
    )
    random = np.random.default_rng(SEED)
    print("seed", SEED)
    x = mesh.node_positions
    slopes = random.normal(size=(3, 3))
    positions = x @ (np.eye(3) + 0.1 * slopes) + 0.03 * np.sin(60.0 * x[:, [1, 2, 0]]) * 0.02
    direction = np.sin(80.0 * x @ random.normal(size=(3, 3)) + 1.0)
    direction[0] = 0.0
    return bound, positions, direction


def curvature(term, positions, direction, reach=1.0e-5):
    found = np.zeros((len(positions) - 1, 3))
    term.add_force_curvature(positions, direction, reach, found)
    return found


@pytest.mark.parametrize("law, element", [
    ("corotational", "linear"), ("neo_hookean", "linear"), ("corotational", "quadratic"),
    ("corotational", "smoothed"), ("neo_hookean", "smoothed"),
])  # fmt: skip
def test_it_is_the_change_of_the_stiffness_along_the_direction(deformed, law, element):
    bound, positions, direction = deformed(law, element)
    found = curvature(bound.terms[0], positions, direction)
    h, x = 1.0e-7, direction[bound.free].ravel()
    after, before = (bound.assemble(positions + s * h * direction)[1] @ x for s in (1.0, -1.0))
    expected = ((after - before) / (2.0 * h)).reshape(-1, 3)
    assert np.abs(found - expected).max() < 1e-6 * np.abs(expected).max()


@pytest.mark.parametrize("law", ["corotational", "neo_hookean"])
def test_that_of_any_term_by_its_forces_agrees_with_that_of_elements(deformed, law):
    bound, positions, direction = deformed(law)
    exact = curvature(bound.terms[0], positions, direction)
    found = np.zeros_like(exact)
    ForceTerm.add_force_curvature(bound.terms[0], positions, direction, 1.0e-5, found)
    assert np.abs(found - exact).max() < 1e-5 * np.abs(exact).max()


def test_linear_elasticity_and_weight_have_none(deformed):
    bound, positions, direction = deformed("linear")
    assert not curvature(bound.terms[0], positions, direction).any()
    weight = Gravity(np.ones(len(positions) - 1), np.array([0.0, 0.0, -9.81]))
    assert not curvature(weight, positions, direction).any()
