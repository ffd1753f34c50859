"""Facts of the rule by which a share of each move is made."""

import numpy as np
import pytest

from softrobot_twin.simulation import CommandSetpoints, FollowTargets, Hold, State
from softrobot_twin.simulation.step.share_rule import Move, ShareRule

WOUND = np.array([0.012, 0.0, 0.0, 0.006])


@pytest.fixture
def shares(monkeypatch):
    """Notes the shares of moves that are made."""
    made, make = [], Move.make
    monkeypatch.setattr(Move, "make", lambda move, at, share: (made.append(share), make(move, at, share)))
    return made


@pytest.fixture
def begun(monkeypatch):
    """Notes what each move begins with."""
    noted, begin = [], ShareRule.begin
    monkeypatch.setattr(ShareRule, "begin", lambda rule, *given: (noted.append(given), begin(rule, *given)))
    return noted


def wind(simulation, wound, steps=10):
    return [simulation.step(CommandSetpoints(simulation.rest_setpoints - wound, 0.02)) for _ in range(steps)]


def test_good_moves_are_made_without_a_search(beam, shares):
    simulation = beam()
    for share in np.arange(1, 11) / 10:
        wind(simulation, 0.5 * share * WOUND, 2)
    assert set(shares) == {1.0}


def test_without_a_search_results_are_the_same_bits_as_without_the_rule(beam, rod, shares):
    simulation, plain = beam(rod), beam(rod)
    plain.newton.share_rule.judges = False
    ends = [wind(made, 0.3 * WOUND)[-1].state.positions for made in (simulation, plain)]
    assert set(shares) == {1.0}
    np.testing.assert_array_equal(*ends)


@pytest.mark.parametrize("too_long", [3.0, 10.0, 30.0])
def test_a_move_that_is_too_long_ends_where_forces_hardly_work_along_it(beam, rod, begun, too_long):
    simulation = beam(rod, {"solver.newton_iterations": 1})
    bent = simulation.state.positions.copy()
    bent[:, 0] -= 0.5 * bent[:, 2] ** 2
    at_rest = simulation.state
    simulation.restore(State(bent, at_rest.setpoints, at_rest.efforts))
    simulation.step(Hold(0.02))
    newton, rule, move = simulation.newton, simulation.newton.share_rule, simulation.newton.move
    actuation, slope, is_judged = begun[-1]
    assert is_judged and slope > 0.0
    move.displacement *= too_long
    rule.begin(actuation, too_long * slope, True)
    positions = simulation.state.positions.copy()

    def work_at(share):
        """Work of the forces there along the whole move [J]."""
        move.make(positions, share)
        newton.residual(positions, actuation)
        return rule.work()

    assert work_at(1.0) < -0.5 * too_long * slope
    share = rule.settle(positions, 1.0, False, False, False)
    left, along = rule.work(), [work_at(part * share) for part in np.linspace(0.0, 1.0, 200)]
    assert 0.0 < share < 1.0 and abs(left) <= 0.5 * too_long * slope and np.mean(along) > 0.0


def test_a_second_try_is_judged_by_the_forces_where_it_begins(beam, monkeypatch):
    simulation = beam()
    newton, slopes, begin, settle = simulation.newton, [], ShareRule.begin, simulation.newton.settle

    def noted(rule, actuation, slope, is_judged):
        begin(rule, actuation, slope, is_judged)
        newton.residual(newton.move.start, actuation)
        slopes.append((slope, rule.work()))

    monkeypatch.setattr(ShareRule, "begin", noted)
    monkeypatch.setattr(newton, "settle", lambda *given: settle(*given) if len(slopes) == 2 else 0.0)
    simulation.step(FollowTargets(simulation.effector_positions() + [0.006, 0.0, -0.003], 1.0))
    for slope, again in slopes[:2]:
        assert slope == pytest.approx(again, rel=1e-9)
