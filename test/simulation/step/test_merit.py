"""Facts of the merit that a move towards a static equilibrium lowers."""

import numpy as np
import pytest

from softrobot_twin.simulation import CommandSetpoints, FollowTargets, Hold, State
from softrobot_twin.simulation.step.merit import Merit

WOUND = np.array([0.012, 0.0, 0.0, 0.006])


@pytest.fixture
def searches(monkeypatch):
    """Counts the searches by the merit."""
    made = []
    search = Merit.search

    def counted(*arguments):
        made.append(arguments)
        return search(*arguments)

    monkeypatch.setattr(Merit, "search", counted)
    return made


def wind(simulation, wound, steps=10):
    return [
        simulation.step(CommandSetpoints(simulation.rest_setpoints - wound, 0.02))
        for _ in range(steps)
    ]


def test_good_moves_are_made_without_a_search(beam, searches):
    simulation = beam()
    for share in np.arange(1, 11) / 10:
        wind(simulation, 0.5 * share * WOUND, 2)
    assert not searches


def test_without_a_search_results_are_the_same_bits_as_without_a_merit(beam, rod, searches):
    simulation, plain = beam(rod), beam(rod)
    plain.newton.merit.judges = False
    ends = [wind(made, 0.3 * WOUND)[-1].state.positions for made in (simulation, plain)]
    assert not searches
    np.testing.assert_array_equal(*ends)


@pytest.mark.parametrize("too_long", [3.0, 10.0, 30.0])
def test_a_move_that_is_too_long_is_shortened_until_it_lowers_the_merit(beam, rod, too_long):
    simulation = beam(rod, {"solver.newton_iterations": 1})
    bent = simulation.state.positions.copy()
    bent[:, 0] -= 0.5 * bent[:, 2] ** 2
    at_rest = simulation.state
    simulation.restore(State(bent, at_rest.setpoints, at_rest.efforts))
    simulation.step(Hold(0.02))
    newton, merit = simulation.newton, simulation.newton.merit
    assert merit.is_judging
    positions = simulation.state.positions.copy()
    move = newton.move
    start = move.start
    move.displacement *= too_long
    share = merit.search(positions, 1.0)
    assert 0.0 < share < 1.0

    def energy_change(to):
        """Work of the forces along the move, by many intervals."""
        at, total, count = start.copy(), 0.0, 200
        previous = merit.energy_slope(at)
        for part in np.arange(1, count + 1) / count:
            move.make(at, part * to)
            power = merit.energy_slope(at)
            total += 0.5 * (previous + power) * to / count
            previous = power
        return total

    change = energy_change(share)
    for sign, at in ((1.0, positions), (-1.0, start)):
        newton.balance.gather_forces(at)
        change += sign * merit.penalty(at)
    assert change < 0.0


def test_a_second_try_is_judged_by_the_forces_where_it_begins(beam, monkeypatch):
    simulation = beam()
    newton, slopes = simulation.newton, []
    begin = Merit.begin

    def noted(merit, actuation, slope):
        begin(merit, actuation, slope)
        newton.residual(newton.move.start, actuation)
        slopes.append((slope, float(np.vdot(newton.balance.forces, newton.move.displacement))))

    monkeypatch.setattr(Merit, "begin", noted)
    monkeypatch.setattr(newton, "accepts", lambda *_: len(slopes) == 2)
    simulation.step(FollowTargets(simulation.effector_positions() + [0.006, 0.0, -0.003], 1.0))
    (first, first_again), (second, second_again) = slopes[:2]
    assert first == pytest.approx(first_again, rel=1e-9)
    assert second == pytest.approx(second_again, rel=1e-9)
