"""Row 24: a shallow arch of elements snaps through at its limit load.

Two references: the path of the same mesh through the limit point, by the arc-length method (Crisfield
1981, on the normal plane), and the shallow sine arch on two hinges with one term of Galerkin's method.
"""

from typing import NamedTuple

import numpy as np
import pytest
from scipy.interpolate import PchipInterpolator
from scipy.sparse.linalg import splu

from softrobot_twin.geometry.tet_mesh import TetMesh
from softrobot_twin.scene import scene_from_mapping
from softrobot_twin.simulation import Hold, Simulation, Status
from softrobot_twin.solvers.superlu import SuperLU
from test.builder import builder

SPAN, RISE, THICKNESS, WIDTH, YOUNG, DENSITY = 0.1, 0.0021, 0.002, 0.008, 1e6, 1000.0
MIDDLE = np.array([SPAN / 2.0, WIDTH / 2.0, RISE])


@builder
def arch(body_of, block, tmp_path, /, gravity, integration="quasi_static",
         factorization_type=None) -> Simulation:  # fmt: skip
    """Makes the arch, hinged at both ends, under some gravity."""
    mesh = block(size=(SPAN, WIDTH, THICKNESS), cells=(24, 1, 1), shake=0.0)
    x = mesh.node_positions.copy()
    x[:, 2] += RISE * np.sin(np.pi * x[:, 0] / SPAN) - THICKNESS / 2.0
    # The middle of the thickness is held: nodes on a line of mid-edge nodes.
    hinges = [{"box": {"minimum": [end - 1e-9, -1, -1e-9], "maximum": [end + 1e-9, 1, 1e-9]}}
              for end in (0.0, SPAN)]  # fmt: skip
    body = body_of(TetMesh(x, mesh.cells), "arch", YOUNG, 0.0, element="quadratic",
                   fixed=hinges, damping={"mass": 5.0, "stiffness": 0.01})  # fmt: skip
    scene = {
        "name": "arch", "body": body, "gravity": [0, 0, -gravity], "integration": integration,
        "solver": {"newton_iterations": 60, "residual_tolerance": 1e-9},
    }  # fmt: skip
    read = scene_from_mapping(scene, tmp_path / "scene.yaml")
    return Simulation(read, factorization_type=factorization_type)


def height(simulation, positions):
    """Where its middle is [m]."""
    rest = simulation.model.nodes.rest_positions
    return positions[np.argmin(np.abs(rest - MIDDLE).sum(axis=1)), 2]


def term(simulation, name):
    return next(term for term in simulation.model.forces if name in term.name)


class Branches(NamedTuple):
    """The path of equilibria: its limit load [m/s²], and heights by load before and beyond."""

    limit: float
    before: PchipInterpolator
    beyond: PchipInterpolator


def followed(simulation) -> Branches:
    """Follow the equilibria under growing gravity, g = 1 m/s² a unit, beyond both limit points."""
    model = simulation.model
    free, matrix = model.nodes.free_nodes, model.factorization
    weights = term(simulation, "gravity").weights.ravel()

    def seen(x):
        forces = np.zeros((len(free), 3))
        matrix.clear()
        model.forces[0].add(x, forces, matrix.storage, False)
        return forces.ravel(), splu(matrix.matrix().tocsc())

    x, load, way = model.nodes.rest_positions.copy(), 0.0, weights
    radius = 6e-5 * np.sqrt(len(free))
    path = [(load, height(simulation, x))]
    while path[-1][1] > -1.3 * RISE:
        bent = seen(x)[1].solve(weights)
        sign = np.sign(bent @ way)
        tangent = sign * bent / np.linalg.norm(bent)
        move, more = radius * tangent, sign * radius / np.linalg.norm(bent)
        for _ in range(30):
            there = x.copy()
            there[free] += move.reshape(-1, 3)
            forces, lu = seen(there)
            out = forces + (load + more) * weights
            if np.abs(out).max() < 1e-11:
                break
            free_way, bent = lu.solve(out), lu.solve(weights)
            change = -(tangent @ free_way) / (tangent @ bent)
            move, more = move + free_way + change * bent, more + change
        else:
            raise AssertionError("the path was lost")
        x, load, way = there, load + more, move
        path.append((load, height(simulation, x)))
    loads, heights = np.array(path).T
    top = np.argmax(np.where(heights > 0.0, loads, 0.0))
    bottom = top + np.argmin(loads[top:])
    near = slice(max(top - 2, 0), top + 3)
    parabola = np.polyfit(heights[near], loads[near], 2)
    limit = np.polyval(parabola, -parabola[1] / (2.0 * parabola[0]))
    return Branches(
        limit, PchipInterpolator(loads[: top + 1], heights[: top + 1]),
        PchipInterpolator(loads[bottom:], heights[bottom:]),
    )  # fmt: skip


def galerkin_limit():
    """Gravity at the limit point of a shallow sine arch that keeps its form [m/s²]."""
    k, area, inertia = np.pi / SPAN, WIDTH * THICKNESS, WIDTH * THICKNESS**3 / 12.0
    a = np.linspace(0.0, RISE, 10_001)
    load = YOUNG * k**4 * (inertia * (RISE - a) + 0.25 * area * (RISE**2 - a**2) * a)
    return load.max() * np.pi / 4.0 / (DENSITY * area)


@pytest.mark.exhaustive
def test_the_arch_snaps_through_at_its_limit_load_and_not_before(arch):
    path = followed(arch(1.0, factorization_type=SuperLU))
    # A thickness of 1/50 of the span, and a uniform load for the sine's.
    assert path.limit == pytest.approx(galerkin_limit(), rel=0.03)
    for integration in ("quasi_static", "dynamic"):
        for share in (0.97, 1.03):
            simulation = arch(share * path.limit, integration)
            weights = term(simulation, "gravity").weights
            full = weights.copy()
            lowest = np.inf
            for step in range(120):
                weights[:] = full * min(1.0, (step + 1) / 20.0)
                result = simulation.step(Hold(0.05))
                assert result.status in (Status.OK, Status.NOT_CONVERGED)
                lowest = min(lowest, height(simulation, result.state.positions))
            assert result.status is Status.OK
            branch = path.before if share < 1.0 else path.beyond
            expected = branch(share * path.limit)
            reached = height(simulation, result.state.positions)
            assert reached == pytest.approx(float(expected), abs=0.01 * RISE)
            assert (lowest > 0.0) == (share < 1.0)
