"""Facts of the tangent that is augmented by the rows of held cables."""

import numpy as np
import pytest

from softrobot_twin.constraints.row_stack import RowStack
from softrobot_twin.scene import load_scene
from softrobot_twin.simulation import CommandSetpoints, FollowTargets, Simulation
from softrobot_twin.simulation.step.augmented_tangent import (
    AUGMENTATION,
    AugmentedLU,
    AugmentedTangent,
    HeldActuators,
)
from softrobot_twin.solvers.factorization import NodeRows
from softrobot_twin.solvers.inverse_problem import Bounds
from test.builder import builder
from test.places import SCENES
from test.scene_changes import repeat_step


def held_within(count, effort_max):
    """Actuators held at rest, with efforts from zero to one that they may not exceed."""
    bounds = Bounds(*np.zeros((3, count)), np.full(count, effort_max))
    return HeldActuators(np.zeros(count), bounds, bounds, True)


@pytest.fixture
def tangents(diamond):
    """The exact and the augmented condensed system of a deformed Diamond, by the same factor."""

    class Tangents:
        def __init__(self):
            simulation = diamond()
            wound = np.array([0.004, 0.001, 0.0, 0.003])
            simulation.step(CommandSetpoints(simulation.rest_setpoints - wound, 0.1))
            self.newton, self.model = simulation.newton, simulation.model
            self.positions, self.efforts = simulation.state.positions, simulation.state.efforts
            rows, factorization = self.model.rows, self.model.factorization
            self.newton.balance.assemble(self.positions, rows.multipliers(self.efforts), False)
            assert factorization.factor()
            self.b = self.newton.balance.forces.copy()
            self.H = NodeRows(rows.row_index, rows.node_index, rows.blocks.copy(), rows.row_count)
            self.exact = factorization.condense(self.H, self.b)

        def augment(self, chosen):
            """Augment the chosen cables; gives the tangent and what it condenses."""
            augmented = AugmentedTangent(
                self.model.rows, self.model.factorization, np.ones(4, bool)
            )
            count = self.model.rows.groups.actuators.stop
            augmented.measure(self.exact.W[:count, :count])
            efforts = np.where(chosen, 1.0, 0.0)
            held = held_within(count, 9.0)
            assert augmented.choose(efforts, held)
            rows = self.model.rows
            self.newton.balance.assemble(self.positions, rows.multipliers(self.efforts), False)
            assert augmented.factor(self.positions)
            return augmented, augmented.condense(self.H, self.b)

    return Tangents()


@pytest.mark.parametrize("chosen", [[1, 1, 1, 1], [1, 0, 0, 1], [0, 1, 0, 0]])
def test_the_augmented_compliance_is_that_of_the_augmented_matrix(tangents, chosen):
    augmented, found = tangents.augment(np.array(chosen, bool))
    exact, rho = tangents.exact, np.zeros(tangents.H.row_count)
    rho[:4] = augmented.stiffness
    # (A + Hᵀ ρ H)⁻¹ seen from H: W - W (ρ⁻¹ + W)⁻¹ W.
    expected = np.linalg.solve(np.eye(len(rho)) + exact.W * rho, exact.W)
    np.testing.assert_allclose(found.W, expected, atol=1e-11 * np.abs(expected).max())
    free = np.linalg.solve(np.eye(len(rho)) + exact.W * rho, exact.free)
    np.testing.assert_allclose(found.free, free, atol=1e-11 * np.abs(free).max())


def test_the_displacement_is_that_of_the_exact_tangent_under_the_same_efforts(tangents):
    multipliers = np.zeros(tangents.H.row_count)
    multipliers[:4] = [3.0, 1.0, 0.0, 2.0]
    exact, factorization = tangents.exact, tangents.model.factorization
    rows = tangents.model.rows
    tangents.newton.balance.assemble(tangents.positions, rows.multipliers(tangents.efforts), False)
    assert factorization.factor()
    factorization.condense(tangents.H, tangents.b)
    expected = factorization.expand(multipliers).copy()
    moved = exact.W @ multipliers + exact.free
    augmented, _ = tangents.augment(np.array([True, True, False, True]))
    augmented_multipliers = multipliers.copy()
    augmented_multipliers[:4] += augmented.stiffness * moved[:4]
    found = augmented.expand(augmented_multipliers)
    np.testing.assert_allclose(found, expected, atol=1e-11 * np.abs(expected).max())


def test_an_indefinite_plain_tangent_is_detected(tangents):
    augmented, found = tangents.augment(np.ones(4, bool))
    assert not augmented.is_needed(found.W, 4)
    # A compliance beyond 1/ρ is that of an indefinite tangent.
    assert augmented.is_needed(1.1 * np.diag(1.0 / augmented.stiffness), 4)


def test_efforts_come_back_from_the_solution(tangents):
    augmented, _ = tangents.augment(np.array([True, True, True, False]))
    reference = np.full(4, 1e-3)
    displacements = np.array([1e-3, 1.1e-3, 0.9e-3, 1.2e-3])
    solved = np.array([2.0, 2.0, 2.0, 2.0])
    found = augmented.augmentation(reference).efforts(solved, displacements)
    expected = solved - augmented.stiffness * (displacements - reference)
    np.testing.assert_allclose(found, expected)
    assert found[0] == found[3] == 2.0 and found[1] < 2.0 < found[2]


@pytest.mark.parametrize("kind", ["cables", "any actuators"])
def test_the_solution_for_any_forces_is_that_of_the_condensed_system(beam, kind):
    """Cables of several stretches, whose rows couple more unknowns than the elements do."""
    simulation = beam()
    wound = np.array([0.004, 0.001, 0.0, 0.003])
    simulation.step(CommandSetpoints(simulation.rest_setpoints - wound, 0.1))
    model, newton, state = simulation.model, simulation.newton, simulation.state
    rows, factorization = model.rows, model.factorization
    if kind == "cables":
        augmented = AugmentedTangent(rows, factorization, np.ones(4, bool))
    else:
        augmented = AugmentedLU(rows, factorization, np.ones(4, bool))
    newton.balance.assemble(state.positions, rows.multipliers(state.efforts), False)
    assert factorization.factor()
    H = NodeRows(rows.row_index, rows.node_index, rows.blocks.copy(), rows.row_count)
    b = newton.balance.forces.copy()
    augmented.measure(factorization.condense(H, b).W[:4, :4])
    held = held_within(4, 9.0)
    assert augmented.choose(np.array([1.0, 1.0, 0.0, 1.0]), held)
    newton.balance.assemble(state.positions, rows.multipliers(state.efforts), False)
    assert augmented.factor(state.positions)
    augmented.condense(H, b)
    expected = augmented.expand(np.zeros(rows.row_count)).copy()
    found = augmented.solve(b)
    np.testing.assert_allclose(found, expected, atol=1e-10 * np.abs(expected).max())
    augmented.condense(H, b)
    plain = factorization.solve(b)
    assert np.abs(plain - expected).max() > 1e-3 * np.abs(expected).max()


@pytest.mark.parametrize(
    "wound",  # mm
    [[16.3, 18.3, 12.1, 14.6], [17.1, 0.7, 14.6, 3.5]],
)
def test_a_fine_mesh_converges_quadratically_where_its_tangent_is_indefinite(diamond, wound):
    """The projected tangent leaves residuals of 1e-5 to 1e-3 N after 40 linearizations here."""

    def finer(mapping):
        mapping["body"]["mesh"]["file"] = "../../meshes/diamond_1600.vtk"
        mapping.setdefault("solver", {})["newton_iterations"] = 1

    simulation = diamond(finer)
    newton, shortening = simulation.newton, 1e-3 * np.array(wound)
    for share in np.arange(1, 13) / 12:
        simulation.step(CommandSetpoints(simulation.rest_setpoints - share * shortening, 0.5))
    residuals = []
    for _ in range(14):
        command = CommandSetpoints(simulation.rest_setpoints - shortening, 0.5)
        report = simulation.step(command).report
        assert not report.projected_tangent
        residuals.append(report.residual)
    assert newton.tangent.is_augmented
    assert residuals[-1] < 1e-11
    first = next(k for k, residual in enumerate(residuals) if residual < 1e-6)
    # Quadratic: each linearization doubles the digits, down to the round-off.
    assert residuals[first + 1] < 1e-9 and residuals[first + 2] < 1e-11


@builder
def leaning(beam, rod, /, element, wound):
    """Makes a beam that winds its cables beside a rod and leans on it, at rest."""
    simulation = beam(rod, {"body.element": element})
    for _ in range(60):
        lengths = simulation.rest_setpoints - wound
        result = simulation.step(CommandSetpoints(lengths, 0.02))
    assert result.report.contact_count
    return simulation, result


def test_contacts_that_press_are_augmented_too(leaning):
    simulation, _ = leaning("linear", [0.012, 0.0, 0.003, 0.0])
    newton, model = simulation.newton, simulation.model
    positions, efforts = simulation.state.positions, simulation.state.efforts
    rows, factorization, contacts = model.rows, model.factorization, model.contacts
    rows.detect(positions)
    newton.balance.assemble(positions, rows.multipliers(efforts), False)
    assert factorization.factor()
    H = NodeRows(rows.row_index, rows.node_index, rows.blocks.copy(), rows.row_count)
    exact = factorization.condense(H, newton.balance.forces.copy())
    augmented = AugmentedTangent(rows, factorization, np.ones(4, bool), contacts=contacts)
    augmented.measure(exact.W[:4, :4])
    held = held_within(4, 40.0)
    assert augmented.choose(efforts, held)
    pressing = contacts.last_multipliers > 0.0
    np.testing.assert_array_equal(augmented.contact_stiffness > 0.0, pressing)
    assert pressing.any()
    newton.balance.assemble(positions, rows.multipliers(efforts), False)
    assert augmented.factor(positions)
    found = augmented.condense(H, newton.balance.forces.copy())
    rho = np.zeros(rows.row_count)
    rho[:4], rho[rows.groups.contacts] = augmented.stiffness, augmented.contact_stiffness
    expected = np.linalg.solve(np.eye(len(rho)) + exact.W * rho, exact.W)
    np.testing.assert_allclose(found.W, expected, atol=1e-10 * np.abs(expected).max())
    gaps = rows.values[rows.groups.contacts]
    np.testing.assert_array_equal(
        augmented.contact_shift(gaps), -augmented.contact_stiffness * gaps
    )


@pytest.mark.parametrize("wound", [
    [0.01965, 0.0, 0.0, 0.0], [0.01763, 0.0, 0.00246, 0.00485], [0.01884, 0.00552, 0.00752, 0.0],
])  # fmt: skip
def test_a_beam_that_its_contacts_stabilise_rests_without_projection(leaning, wound):
    """By the projected tangent residuals of 1e-5 to 1e-4 N are left after 150 linearizations."""
    simulation, result = leaning("quadratic", wound)
    assert result.report.residual < 1e-6
    assert simulation.newton.tangent.is_augmented and not simulation.newton.tangent.is_projected


@pytest.mark.exhaustive
def test_beside_the_limit_of_stability_an_inverse_neither_chatters_nor_misses():
    """The Diamond at its working height is stable at given tensions in one place and not in the
    next: by the plain tangent the cables go back and forth by 0.5 mm there."""
    simulation = Simulation(load_scene(SCENES / "diamond.yaml"))
    time = np.arange(0.0, 3.0, 0.01)
    turn = 2.0 * np.pi * time / 7.5
    path = 0.020 * np.stack([np.cos(turn), np.sin(turn) * np.cos(turn), 6.8 + 0.0 * turn], axis=1)
    repeat_step(simulation, FollowTargets(path[:1], 0.01), 200)
    found = [simulation.step(FollowTargets(target[None], 0.01)) for target in path]
    assert max(result.effector_errors[0] for result in found) < 1e-6
    setpoints = np.array([result.setpoints for result in found])
    assert np.abs(np.diff(setpoints, 2, axis=0)).max() < 1e-5


def test_a_tangent_that_is_hardly_definite_is_left_to_the_augmented_one_with_hysteresis():
    """Its softest way yields 1 / NEARLY_INDEFINITE times 1/ρ at most, and comes back at a half."""
    own = np.array([2.0, 5.0])
    tangent, stiffness = AugmentedTangent(RowStack([]), None, np.ones(2, bool), own), AUGMENTATION * own
    turn = np.array([[0.6, -0.8], [0.8, 0.6]])
    for softest, near in ((99.0, False), (101.0, True)):
        W = turn @ np.diag([softest, 1.0]) @ turn.T / np.sqrt(np.outer(stiffness, stiffness))
        assert tangent.is_near(W) is near
    tangent.stiffness, tangent.contact_stiffness = stiffness, np.empty(0)
    for softest, needed in ((48.0, False), (50.0, True), (-3.0, True)):
        augmented = turn @ np.diag([softest / (1.0 + softest), 0.5]) @ turn.T
        W = augmented / np.sqrt(np.outer(stiffness, stiffness))
        assert tangent.is_needed(W, 2) is needed
