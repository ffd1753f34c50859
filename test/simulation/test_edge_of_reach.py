"""Facts of targets far outside the workspace: rows 16 and 32."""

import numpy as np
import pytest
from scipy.optimize import minimize

from softrobot_twin.simulation import CommandSetpoints, FollowTargets, Hold, Simulation, Status
from softrobot_twin.simulation.step.actuation import INVERSION
from test.builder import builder
from test.scene_changes import LEFT_OUT, changed, repeat_step

HELD_BACK = (Status.SATURATED, Status.UNREACHABLE)


@builder
def trunk(coarse_trunk, /, has_cylinders: bool, slides: bool) -> Simulation:
    """Makes the coarse Trunk, with or without what it touches and what carries it."""

    def change(mapping):
        if not has_cylinders:
            del mapping["obstacles"], mapping["contact"]
        if not slides:
            del mapping["slides"]

    return coarse_trunk(change)


# A robot of which nothing has moved for longer than the twin is patient stays where it is: nothing
# that its next step depends on changes any more.
STILL, UNMOVED = 80, 1e-9


def steps_towards(simulation, target, count):
    """Results of steps towards a target [m], until the robot is still, but so many at most."""
    results, calm = [], 0
    before = simulation.state
    while len(results) < count and calm < STILL:
        results.append(simulation.step(FollowTargets(target, 0.02)))
        state = results[-1].state
        moved = max(np.abs(state.positions - before.positions).max(),
                    np.abs(state.setpoints - before.setpoints).max())  # fmt: skip
        # All of the calm steps together may not move it further.
        calm, before = (calm + 1, before) if moved < UNMOVED else (0, state)
    return results


def follow(simulation, target, count):
    """The last result of steps towards a target [m], and the setpoints of all."""
    results = steps_towards(simulation, target, count)
    return results[-1], np.array([result.setpoints for result in results])


WAYS = {"sideways": [1.9, 0.0, 0.0], "up": [0.0, 1.9, 0.0], "aslant": [1.9, 1.9, 0.0],
        "back": [0.0, 0.0, -1.9]}  # fmt: skip
# Each of both with and without the other, and the two hardest: (slides, has_cylinders, way).
TRUNKS = [
    (False, False, "sideways"), (True, True, "aslant"), (False, True, "back"), (True, False, "back"),
    (True, True, "back"), (True, True, "up"),
]  # fmt: skip
# Pulled straight back, the Trunk buckles several times on its way to the nearest point. On a slide
# it may come home compressed, snap, and come home again. How late it rests, round-off decides: out,
# between the cylinders, targets aslant that differed by 1 nm took 218 to 375 steps, and without
# cylinders those sideways took 174 to 398; home from above, on its slide between the cylinders, 24
# ways took 375 to 2029 steps. A robot that is still ends the run earlier.
STEPS_TO_REST = {"back": 700, "sideways": 700, "aslant": 700}
BACK, BACK_ON_A_SLIDE, LENGTHS_HOME = 300, 4000, 120


@pytest.mark.exhaustive
@pytest.mark.parametrize("slides, has_cylinders, way", TRUNKS)
def test_the_trunk_comes_to_rest_at_targets_ten_times_too_far(trunk, slides, has_cylinders, way):
    simulation = trunk(has_cylinders, slides)
    far = simulation.effector_positions() + WAYS[way]
    result, lengths = follow(simulation, far, STEPS_TO_REST.get(way, 350))
    assert result.status in HELD_BACK and result.report.active_limits
    assert np.ptp(lengths[-60:], axis=0).max() < 1e-6
    assert result.effector_errors[0] < np.linalg.norm(WAYS[way])


@pytest.mark.exhaustive
@pytest.mark.parametrize("way, has_cylinders, slides", [
    pytest.param(
        way, has_cylinders, slides,
        id="-".join((way, ("free", "cylinders")[has_cylinders], ("fixed", "sliding")[slides])),
    )
    for slides, has_cylinders, way in TRUNKS
])  # fmt: skip
def test_the_trunk_returns_from_targets_ten_times_too_far(trunk, slides, has_cylinders, way):
    simulation = trunk(has_cylinders, slides)
    home, rest = simulation.effector_positions(), simulation.state
    follow(simulation, home + WAYS[way], 120)
    back, _ = follow(simulation, home, BACK_ON_A_SLIDE if slides else BACK)
    is_back = back.effector_errors[0] < 1e-4
    # On a slide, which can press the whole body together, the way home may end in another shape, and
    # round-off decides which: from above between the cylinders 18 of 24 ways from targets that
    # differed by 1 nm did, on the others two of 42. Then the twin tells that the tip is not back.
    assert is_back or (slides and back.status in HELD_BACK)
    assert back.status.is_success or back.report.active_limits == (INVERSION,) or not is_back
    # The body keeps nothing of it: at the lengths at rest it has its shape at rest.
    repeat_step(simulation, CommandSetpoints(rest.setpoints, 0.02), LENGTHS_HOME)
    np.testing.assert_allclose(simulation.state.positions, rest.positions, atol=1e-6)


@pytest.mark.sampled
@pytest.mark.parametrize("way", [[1, 0, 0], [0.7, -0.7, 0], [0, 0, -1], [0, 0, 1]])
def test_the_diamond_comes_to_rest_at_targets_ten_times_too_far_and_returns(diamond, way):
    simulation = diamond()
    home = simulation.effector_positions()
    result, lengths = follow(simulation, home + way, 150)
    assert result.status is Status.SATURATED and result.report.active_limits
    assert np.ptp(lengths[-60:], axis=0).max() < 1e-6
    back, _ = follow(simulation, home, 100)
    assert back.status is Status.OK


@pytest.mark.exhaustive
@pytest.mark.parametrize("way", [[-0.9, -0.9, -0.9], [0, -0.9, -0.9], [0.9, 0, 0], [0.9, 0.9, 0]])
@pytest.mark.parametrize("directions", [["x"], ["z"], ["x", "y", "z"]], ids="".join)
def test_a_beam_of_eight_cables_beside_a_rod_comes_to_rest_at_targets_too_far(eight, directions, way):
    """Row 32."""
    simulation = eight(directions)
    _, lengths = follow(simulation, simulation.effector_positions() + way, 400)
    assert np.ptp(lengths[-STILL:], axis=0).max() < 1e-8


OUT, TAIL = 350, 60
# Directions are drawn with seeds, two with each; a direction is named by its seed and its number.
DRAWN = 2


def directions(seed: int) -> np.ndarray:
    """Random directions, shape (DRAWN, 3)."""
    drawn = np.random.default_rng(seed).standard_normal((DRAWN, 3))
    return drawn / np.linalg.norm(drawn, axis=1)[:, None]


def in_random_directions(*names, drawn=None):
    """Parametrizes a test by the name of a robot, a seed and the number of a direction.

    Args:
        names: Of the robots.
        drawn: Seed and number of each direction; by default each robot has one, by turns.
    """
    turns = [drawn or [((1, 0), (2, 1))[place % 2]] for place in range(len(names))]
    cases = [
        pytest.param(name, seed, number, id=f"{name}-seed {seed}-{number}")
        for name, directions in zip(names, turns, strict=True) for seed, number in directions
    ]  # fmt: skip
    return pytest.mark.parametrize("name, seed, number", cases)


@pytest.fixture
def robot(beam, eight, rod, coarse_trunk, diamond):
    """Makes a robot by its name, settled under its weight; and a distance far out of its reach."""

    def slender(mapping):
        """Linear elements lock in a beam of one cell across: it would hardly bend."""
        mapping["body"]["element"] = "quadratic"
    beside_a_rod = changed(slender, rod)
    def trunk(*without):
        def change(mapping):
            for entry in without:
                del mapping[entry]

        return coarse_trunk(change)

    makes = {
        "beam": (lambda: beam(slender), 1.0), "beam and rod": (lambda: beam(beside_a_rod), 1.0),
        "eight cables and rod": (lambda: eight(change=beside_a_rod), 0.2),
        "eight cables and rod, further": (lambda: eight(change=beside_a_rod), 1.0),
        "Trunk": (lambda: trunk("obstacles", "contact", "slides"), 1.9),
        "Trunk with slide": (lambda: trunk("obstacles", "contact"), 1.9),
        "Trunk between cylinders": (lambda: trunk("slides"), 1.9),
        "Trunk between cylinders with slide": (trunk, 1.9), "Diamond": (diamond, 0.9),
    }  # fmt: skip

    def make(name: str) -> tuple[Simulation, float]:
        make_it, distance = makes[name]
        simulation = make_it()
        repeat_step(simulation, Hold(), 20)
        return simulation, distance

    return make


def asked_for(robot, name, seed, number) -> tuple[Simulation, np.ndarray, np.ndarray]:
    """A robot, where its effector is, and a target far away in a random direction [m]."""
    simulation, distance = robot(name)
    home, way = simulation.effector_positions().copy(), directions(seed)[number]
    print(f"seed {seed}, direction {way.round(3).tolist()}, {distance} m")
    return simulation, home, home + distance * way


@pytest.mark.sampled
@in_random_directions(
    "eight cables and rod", "eight cables and rod, further", "Trunk", "Trunk with slide",
    "Trunk between cylinders", "Trunk between cylinders with slide", "Diamond",
)  # fmt: skip
def test_at_targets_ten_times_too_far_lengths_rest_and_home_is_reached(robot, name, seed, number):
    """Rows 16 and 32."""
    simulation, home, target = asked_for(robot, name, seed, number)
    last = steps_towards(simulation, target, OUT)[-TAIL:]
    assert np.ptp([result.setpoints for result in last], axis=0).max() < 1e-6
    wrong = {result.status for result in last if result.status.is_failure}
    assert not wrong and Status.INVERTED not in {result.status for result in last}
    assert max(result.report.inverted_count for result in last) == 0
    slides = name.endswith("with slide")
    back = steps_towards(simulation, home, BACK_ON_A_SLIDE if slides else BACK)[-1]
    assert back.effector_errors[0] <= 1e-4


@pytest.mark.exhaustive
def test_a_slide_comes_to_its_end_while_cables_creep_along_a_curved_edge(coarse_trunk):
    """Cables become slack and taut there, and the radius is a thousandth of their scales."""
    simulation = coarse_trunk({"body.element": "smoothed", "obstacles": LEFT_OUT, "contact": LEFT_OUT})
    target = simulation.effector_positions() + 1.9 * directions(1)[0]
    assert steps_towards(simulation, target, OUT)[-1].setpoints[-1] == pytest.approx(0.06, abs=1e-4)


@pytest.mark.exhaustive
def test_a_trunk_that_folded_on_its_way_home_lets_go_and_comes_home(robot):
    """Compressed by its slide between the cylinders, it folds 5 mm from home."""
    simulation, home, target = asked_for(robot, "Trunk between cylinders with slide", 7, 0)
    steps_towards(simulation, target, OUT)
    result = repeat_step(simulation, FollowTargets(home, 0.02), BACK)
    assert result.status is Status.OK and result.effector_errors[0] <= 1e-4


@pytest.mark.exhaustive
def test_a_diamond_that_sways_into_another_shape_comes_as_near_as_by_a_nearer_target(robot):
    """Its four cables pull against each other near a limit of stability, and the apex sways away."""
    way, ends = np.array([0.50890039, -0.34095863, 0.6593691]), []
    for share in (0.1, 1.0):
        simulation, _ = robot("Diamond")
        home = simulation.effector_positions().copy()
        reached = steps_towards(simulation, home + share * way, OUT)[-1].effector_positions
        ends.append(float(np.linalg.norm(reached - home - way)))
    assert ends[1] <= ends[0] + 1e-3


@pytest.mark.exhaustive
def test_a_beam_that_slipped_around_the_rod_comes_home_the_way_it_went(robot):
    """Straightened behind the rod, its tip rests 43 mm from home with all lengths at rest."""
    simulation, distance = robot("eight cables and rod")
    home = simulation.effector_positions().copy()
    steps_towards(simulation, home + distance * np.array([0.572, 0.071, -0.817]), OUT)
    result = repeat_step(simulation, FollowTargets(home, 0.02), BACK)
    assert result.status is Status.OK and result.effector_errors[0] <= 1e-4


# Shortenings that the optimisation may choose [m].
LONGEST = {"beam": 0.02, "beam and rod": 0.02, "Diamond": 0.04}
# Where facets and edges of the coarse beam roll over the rod, the distance has local minima, at
# some of which a change of lengths by 0.1 mm leads over the next ridge. The twin does not search
# beyond them; the optimisation does, and ends 2 mm (seed 1, direction 0) and 12 mm (seed 2,
# direction 0) nearer. In the other direction of each seed the twin rests at none.
WITHOUT_LOCAL_MINIMA = ((1, 1), (2, 1))
# A distance longer than any [m], where a body does not come to balance.
NOWHERE = 10.0


def distance_at(simulation, target, begin, shortenings, increments) -> float:
    """Distance of the tip from a target [m], in equilibrium at prescribed lengths.

    Args:
        simulation: Moved.
        target: The target [m].
        begin: A state, from which the lengths are changed in small increments; None: at rest.
        shortenings: Of all cables against their lengths at rest [m].
        increments: Their number.
    """
    if begin is None:
        simulation.reset()
    else:
        simulation.restore(begin)
    first, last = simulation.state.setpoints, simulation.rest_setpoints - shortenings
    for share in np.arange(1, increments + 1) / increments:
        result = simulation.step(CommandSetpoints(first + share * (last - first), 10.0))
    for _ in range(30):
        if result.report.residual < 1e-8 or result.status.is_failure:
            break
        result = simulation.step(CommandSetpoints(last, 10.0))
    report = result.report
    if result.status.is_failure or not report.residual < 1e-6 or report.inverted_count:
        return NOWHERE
    return float(np.linalg.norm(result.effector_positions - target))


def nearest_found(simulation, target, begin, start, longest, width, increments) -> float:
    """Distance from a target [m] that a direct search over all shortenings ends at.

    Args:
        simulation, target, begin, increments: See `distance_at`.
        start: Shortenings that the search starts with [m].
        longest: Greatest shortening [m].
        width: Of the simplex that it starts with [m].
    """
    corners = np.where(start > longest - width, -width, width) * np.eye(len(start))
    found = minimize(
        lambda shortenings: distance_at(simulation, target, begin, shortenings, increments),
        start, method="Nelder-Mead", bounds=[(0.0, longest)] * len(start),
        options={"initial_simplex": np.vstack([start, start + corners]), "maxfev": 150,
                 "xatol": 1e-5, "fatol": 1e-5},
    )  # fmt: skip
    return float(found.fun)


def comes_to_rest(robot, name, seed, number):
    """A robot that rests at a far target [m]: it, the target, its distance and shortenings [m]."""
    simulation, _, target = asked_for(robot, name, seed, number)
    result = steps_towards(simulation, target, OUT)[-1]
    shortenings = simulation.rest_setpoints - result.setpoints
    print(f"rests {1e3 * result.effector_errors[0]:.3f} mm from the target at shortenings of "
          f"{(1e3 * shortenings).round(2).tolist()} mm")  # fmt: skip
    own = np.clip(shortenings, 0.0, LONGEST[name])
    return simulation, target, float(result.effector_errors[0]), own


@pytest.mark.exhaustive
@in_random_directions(*LONGEST, drawn=WITHOUT_LOCAL_MINIMA)
def test_no_lengths_near_those_at_rest_lead_nearer(robot, name, seed, number):
    """A search begins where the twin rests, with changes of a twentieth of the range."""
    simulation, target, distance, own = comes_to_rest(robot, name, seed, number)
    longest = LONGEST[name]
    begin = simulation.state
    found = nearest_found(simulation, target, begin, own, longest, longest / 20, 2)
    print(f"search: {1e3 * (found - distance):+.3f} mm")
    assert distance <= found + 1e-3


# Four searches take ten times as long as the one above: in one direction.
@pytest.mark.exhaustive
@in_random_directions("beam and rod", "Diamond", drawn=WITHOUT_LOCAL_MINIMA[:1])
def test_no_lengths_at_all_lead_nearer_than_those_at_rest(robot, name, seed, number):
    """Independent searches begin at rest, at random lengths, and at those where the twin rests."""
    simulation, target, distance, own = comes_to_rest(robot, name, seed, number)
    longest = LONGEST[name]
    random = np.random.default_rng(seed).uniform(0.0, longest, (2, len(own)))
    found = [
        nearest_found(simulation, target, None, start, longest, longest / 4, 8)
        for start in (own, np.zeros_like(own), *random)
    ]
    print("searches:", [f"{1e3 * (best - distance):+.3f} mm" for best in found])
    assert distance <= min(found) + 1e-3


@pytest.mark.exhaustive
@in_random_directions("beam", "beam and rod", "Diamond", "Trunk between cylinders")
def test_noise_of_far_targets_saturates_nothing(robot, name, seed, number):
    """The noise is 1 % of the body's size."""
    simulation, home, target = asked_for(robot, name, seed, number)
    calm = steps_towards(simulation, target, OUT)[-1].effector_positions
    simulation.reset()
    repeat_step(simulation, Hold(), 20)
    size, random = simulation.model.nodes.size, np.random.default_rng(seed)
    places = []
    for _ in range(300):
        noise = 0.01 * size * random.standard_normal(3)
        result = simulation.step(FollowTargets(target + noise, 0.02))
        assert not result.status.is_failure and result.status is not Status.INVERTED
        places.append(result.effector_positions)
    off = np.linalg.norm(np.array(places[-TAIL:]) - calm, axis=(1, 2)).max()
    print(f"{1e3 * off:.3f} mm from where it rests without noise")
    assert off < 0.02 * size
    back = steps_towards(simulation, home, BACK)[-1]
    assert back.effector_errors[0] <= 1e-4
