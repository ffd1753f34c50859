"""Reduced bodies in motion: as the full model where the basis spans everything, and of few modes."""

from dataclasses import replace

import numpy as np
import pytest

from softrobot_twin.analysis.linear_model import ModalTangent
from softrobot_twin.simulation import CommandEfforts, CommandSetpoints, Hold, Status
from softrobot_twin.simulation.effects.touches import Touched

from .building.test_reduced_body import saved, spanning_basis
from .test_reduced_contact import modes_of, saved_beside
from test.analysis.test_linear_model import ALPHA, STEP, TENSIONS, at_rest, deviations, finger_mapping
from test.builder import builder

SCHEMES = {"backward_euler": {}, "generalized_alpha": {"time_scheme": "generalized_alpha"}}
EXACT = {"solver": {"newton_iterations": 30, "residual_tolerance": 1e-10}}
RUBBER = {"law": "neo_hookean", "young_modulus": 3e5, "poisson_ratio": 0.4, "density": 1e3}


def moving(scheme, damping=None, gravity=(0.0, -9.81, 0.0), **body):
    """A change of a scene to one in motion."""
    def change(mapping):
        mapping |= EXACT | {"integration": "dynamic", "gravity": list(gravity)} | SCHEMES[scheme]
        mapping["body"] |= body | ({} if damping is None else {"damping": damping})
    return change


@pytest.fixture
def spanned(beam, tmp_path):
    """Makes a beam in motion, and the same reduced to a basis that spans everything."""
    def make(*changes):
        full = beam(*changes)
        return full, saved_beside(full, spanning_basis(full.model.bodies[0]), tmp_path / "all.npz")
    return make


@pytest.mark.sampled
@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("damping, body", [
    (None, {}), ({"mass": 2.0, "stiffness": 4e-3}, {}), ({"stiffness": 2e-3}, {"material": RUBBER}),
    ({"mass": 1.0, "stiffness": 2e-3}, {"element": "quadratic", "mass": "consistent"}),
], ids=["free", "damped", "rubber", "quadratic"])  # fmt: skip
def test_a_basis_that_spans_everything_moves_as_the_full_model(spanned, scheme, damping, body):
    pair = spanned(moving(scheme, damping, **body))
    far = 0.0
    for step in range(25):
        wound = 0.004 * np.sin(0.4 * step) ** 2 * np.array([1.0, 0.3, 0.0, 0.0])
        command = CommandSetpoints(pair[0].rest_setpoints - wound, 0.004 if step % 3 else 0.003)
        results = [simulation.step(command) for simulation in pair]
        places = [simulation.effector_positions() for simulation in pair]
        far = max(far, np.linalg.norm(places[0] - [0.01, 0.01, 0.1]))
        assert results[0].status == results[1].status
        np.testing.assert_allclose(places[1], places[0], atol=1e-10)
    assert far > 2e-3
    energies = [sum(term.kinetic_energy(one.state.positions, one.state.velocities)
                    for term in one.model.forces) for one in pair]  # fmt: skip
    assert energies[1] == pytest.approx(energies[0], rel=1e-6) and energies[0] > 0.0


def test_motion_without_inertia_is_that_of_the_full_model(spanned):
    pair = spanned(moving("backward_euler", {"mass": 20.0, "stiffness": 0.05}),
                   lambda mapping: mapping.update(integration="first_order"))  # fmt: skip
    assert not any("inertia" in term.name for term in pair[1].model.forces)
    for _ in range(10):
        for simulation in pair:
            simulation.step(Hold(0.01))
        places = [simulation.effector_positions() for simulation in pair]
        np.testing.assert_allclose(places[1], places[0], atol=1e-10)
    assert np.linalg.norm(places[0] - [0.01, 0.01, 0.1]) > 1e-4


def without_cables(mapping):
    del mapping["cables"]


@builder
def few(beam, tmp_path, /, scheme, damping=None, gravity=(0.0, -9.81, 0.0), change=None, count=12):
    """Makes a beam in motion, and the same reduced to few modes of states at rest."""
    still = beam(EXACT)
    states = []
    for east in (0.0, 0.002, 0.004):
        for north in (0.0, 0.002, 0.004):
            for west, south in ((east, north), (0.0, 0.0), (0.001, 0.0), (0.0, 0.0015)):
                wound = np.array([east - min(east, west), north - min(north, south), west, south])
                still.step(CommandSetpoints(still.rest_setpoints - wound, 10.0))
                still.step(CommandSetpoints(still.rest_setpoints - wound, 10.0))
                states.append(still.state.positions - still.model.nodes.rest_positions)
    full = beam(moving(scheme, damping, gravity), change or without_cables)
    return full, saved_beside(full, modes_of(np.array(states), count), tmp_path / "few.npz")


def let_go(simulation, coordinates, velocities=None):
    """Begins at coordinates of a reduced body [m]."""
    positions = simulation.model.nodes.rest_positions.copy()
    nodes = simulation.model.bodies[0].coordinate_nodes
    positions[nodes] = coordinates.reshape(-1, 3)
    for kind in simulation.model.nodes.kinds:
        kind.place(positions)
    moving = np.zeros_like(simulation.state.velocities) if velocities is None else velocities
    simulation.restore(replace(simulation.state, positions=positions, velocities=moving))


@pytest.mark.sampled
@pytest.mark.parametrize("damping", [None, {"mass": 3.0, "stiffness": 2e-3}])
@pytest.mark.parametrize("time_step", [0.001, 0.02, 0.3])
def test_energy_never_grows_without_input(few, energies, time_step, damping, drawn_rng):
    """From random shapes and velocities, in short, long and very long steps: backward Euler."""
    _, reduced = few("backward_euler", damping)
    let_go(reduced, 0.002 * drawn_rng.standard_normal(12), 0.1 * drawn_rng.standard_normal((4, 3)))
    totals = [sum(energies(reduced))]
    for _ in range(300):
        assert reduced.step(Hold(time_step)).status is Status.OK
        totals.append(sum(energies(reduced)))
    lost = totals[0] - min(totals)
    assert np.diff(totals).max() <= 1e-9 * lost
    assert totals[-1] < totals[0] - 0.05 * lost


@pytest.mark.sampled
@pytest.mark.parametrize("radius", [0.0, 0.8])
@pytest.mark.parametrize("time_step", [0.002, 0.1])
def test_a_scheme_of_second_order_neither_gains_nor_blows_up_over_a_long_run(
    few, energies, radius, time_step, drawn_rng
):
    """Along a basis as with all nodes: energy stays about what it was, or falls by the radius."""
    def change(mapping):
        without_cables(mapping)
        mapping["spectral_radius"] = radius
    _, reduced = few("generalized_alpha", change=change)
    let_go(reduced, 0.001 * drawn_rng.standard_normal(12))
    rest = min(energies(few("generalized_alpha")[1])[0], 0.0)
    totals = [sum(energies(reduced))]
    for _ in range(1500):
        assert reduced.step(Hold(time_step)).status is Status.OK
        totals.append(sum(energies(reduced)))
    start = totals[0] - rest
    assert max(totals) - rest < 1.3 * start
    assert np.mean(totals[-100:]) <= np.mean(totals[:100]) + 0.02 * start


def frequency_and_decay(swings, time_step):
    """Of a vibration about zero: frequency by its crossings [Hz], and rate of its decay [1/s]."""
    k = np.flatnonzero(np.diff(np.sign(swings)) != 0)
    crossings = k + swings[k] / (swings[k] - swings[k + 1])
    half = np.diff(crossings).mean() * time_step
    peaks = [np.abs(swings[a + 1 : b + 1]).max() for a, b in zip(k[:-1], k[1:], strict=True)]
    return 0.5 / half, -np.polyfit(half * np.arange(len(peaks)), np.log(peaks), 1)[0]


@pytest.mark.sampled
@pytest.mark.parametrize("scheme", SCHEMES)
def test_pulled_and_let_go_it_vibrates_and_decays_as_the_full_model(few, scheme):
    pair = few(scheme, {"mass": 3.0, "stiffness": 1e-3}, (0.0, 0.0, 0.0), lambda mapping: [
        cable.update(shortening=[-0.02, 0.02], rate=None) for cable in mapping["cables"]])
    swings, found = [], []
    for pull in 60 * [2.0] + 200 * [0.0]:
        for one in pair:
            one.step(CommandEfforts(np.array([pull, 0.0, 0.0, 0.0]), 0.1 if pull else 0.002))
        if not pull:
            swings.append([one.effector_positions()[0, 0] - 0.01 for one in pair])
    found = [frequency_and_decay(own, 0.002) for own in np.array(swings).T]
    print(f"frequency [Hz] and decay [1/s] of the full and the reduced beam: {found}")
    assert found[1] == pytest.approx(found[0], rel=0.07)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_pushed_and_released_a_spanning_basis_moves_as_the_full_model(spanned, scheme):
    def touched(mapping):
        without_cables(mapping)
        mapping["touches"] = [{"name": "hand", "body": "beam", "points": [[0.01, 0.01, 0.09]]}]
    pair, nowhere = spanned(moving(scheme, {"stiffness": 1e-3}), touched), np.full((1, 3), np.nan)
    sides = []
    for step in range(60):
        push = Touched(np.array([[0.5 if step < 20 else 0.0, 0.0, 0.1 if step < 20 else 0.0]]), nowhere)
        for simulation in pair:
            assert simulation.step(Hold(0.004), measured=push).status is Status.OK
        places = [simulation.effector_positions() for simulation in pair]
        np.testing.assert_allclose(places[1], places[0], atol=1e-10)
        sides.append(places[1][0, 0] - 0.01)
    assert max(sides[:20]) > 1e-3 and min(sides[20:]) < -1e-3


@pytest.mark.parametrize("friction", [0.0, 0.4])
def test_a_spanning_basis_strikes_a_rod_as_the_full_model(spanned, rod, friction):
    """Its weight swings it against the rod, where it stays; with friction it sticks."""
    pair = spanned(moving("backward_euler", {"stiffness": 2e-3}, gravity=(40.0, 0.0, 0.0)),
                   without_cables, lambda mapping: rod(mapping, 0.032, 0.09, friction=friction))  # fmt: skip
    counts = []
    for _ in range(60):
        results = [simulation.step(Hold(0.005)) for simulation in pair]
        counts.append(results[0].report.contact_count)
        assert results[1].report.contact_count == counts[-1]
        places = [simulation.effector_positions() for simulation in pair]
        np.testing.assert_allclose(places[1], places[0], atol=1e-8)
    assert min(counts) == 0 and max(counts) > 0


@pytest.mark.sampled
@pytest.mark.parametrize("scheme", SCHEMES)
def test_a_body_of_few_modes_strikes_a_rod_and_stays(few, rod, energies, scheme):
    """An impact takes energy, whatever the scheme; the modes have never seen the rod."""
    def change(mapping):
        without_cables(mapping)
        rod(mapping, 0.0265, 0.09)
    full, reduced = few(scheme, {"stiffness": 1e-3}, (20.0, 0.0, 0.0), change)
    totals, tips = [], []
    for _ in range(300):
        results = [simulation.step(Hold(0.002)) for simulation in (full, reduced)]
        assert all(result.status is Status.OK for result in results)
        totals.append(sum(energies(reduced)))
        tips.append([one.effector_positions()[0, 0] for one in (full, reduced)])
    tips = np.array(tips)
    assert results[0].report.contact_count and results[1].report.contact_count
    swung = np.ptp(tips[:, 0])
    assert np.abs(tips[:, 1] - tips[:, 0]).max() < 0.2 * swung
    assert np.diff(totals).max() < 0.01 * np.ptp(totals)


@pytest.mark.sampled
@pytest.mark.parametrize("scheme", [{}, ALPHA])
def test_the_linear_model_is_that_of_small_steps(scheme, tmp_path):
    """By the weights of the scheme, exactly; see `test_linear_model`."""
    mapping = saved(finger_mapping(**scheme), tmp_path / "finger.npz", finger_modes)
    reduced = at_rest(mapping, CommandEfforts(TENSIONS, 0.05))
    model = ModalTangent(reduced, np.ones(2, bool)).at_state(None, STEP)
    assert len(model.K) == 15
    small = np.array([2e-4, -1e-4])
    changes = np.where(np.arange(25)[:, None] < 15, small, -small)
    found, predicted = deviations(reduced, model, changes)
    assert np.abs(found - predicted).max() < 1e-3 * np.abs(found).max()
    assert np.abs(found - predicted)[0].max() < 1e-4 * np.abs(found).max()
    full = at_rest({**mapping, "body": {**mapping["body"], "reduced": None}}, CommandEfforts(TENSIONS, 0.05))
    frequencies = ModalTangent(full, np.ones(2, bool)).at_state(None, STEP).frequencies
    # A basis can only stiffen: each mode is at least as fast as the full model's of its number.
    assert (model.frequencies > 0.999 * frequencies[:15]).all()


def finger_modes(body):
    """Bending in both planes, stretch and shear of a finger along x, zero at its root."""
    x, y, z = body.mesh.node_positions.T
    s, zero = x / x.max(), np.zeros_like(x)
    shapes = []
    for power in (2, 3, 4):
        shapes += [[-power * s ** (power - 1) * y / x.max(), s**power, zero],
                   [-power * s ** (power - 1) * z / x.max(), zero, s**power]]  # fmt: skip
    shapes += [[s**power, zero, zero] for power in (1, 2, 3)]
    shapes += [[s * y, zero, zero], [s * z, zero, zero], [zero, s * z, -s * y],
               [zero, s * y, s * z], [zero, s, zero], [zero, zero, s]]  # fmt: skip
    basis = np.array(shapes).transpose(2, 1, 0)
    basis[body.fixed] = 0.0
    return basis / np.linalg.norm(basis, axis=1).max(axis=0)
