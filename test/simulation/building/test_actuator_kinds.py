"""A kind of actuator that is defined here, outside the package: a chamber under pressure.

A chamber is the volume between a patch of a body's surface and a point, such as a bellows that
pushes on the patch. Its setpoint is its volume [m³], its effort the pressure in it [Pa].
"""

from typing import Annotated, ClassVar

import numpy as np
import pytest
from pydantic import AfterValidator

from softrobot_twin.constraints.constraint_term import ConstraintTerm
from softrobot_twin.errors import SceneError
from softrobot_twin.mechanics.stencil import bind_stencils, lower_pairs
from softrobot_twin.scene.actuator_entries import ActuatorEntry
from softrobot_twin.scene.body_entries import BoxRegion
from softrobot_twin.scene.entry import OnBody, Vector, check_range, unit
from softrobot_twin.simulation import (
    CommandEfforts,
    CommandSetpoints,
    FollowTargets,
    Hold,
    Status,
)
from softrobot_twin.simulation.building.actuator_kinds import (
    ActuatorGroup,
    Quantity,
    actuator_kinds,
    group_of,
    ActuatorKind,
    register_actuator,
)
from softrobot_twin.study.explain import effects
from softrobot_twin.tables.input_tables import TableFileError, read_targets
from softrobot_twin.tables.run_columns import RunColumns, actuator_cells
from test.builder import builder
from test.registrations import taken_back
from test.scene_changes import change_scene, changed, solved

STEP = 0.02


class Chamber(OnBody, ActuatorEntry):
    """The volume between a patch of a body's surface and a point."""

    noun: ClassVar[str] = "chamber"

    patch: BoxRegion
    """Triangles of the surface that lie in it."""
    apex: Vector
    expansion: Annotated[tuple[float, float], AfterValidator(check_range), unit("m³")]
    rate: Annotated[float, unit("m³/s")]
    pressure: Annotated[tuple[float, float], AfterValidator(check_range), unit("Pa")]


class Chambers(ConstraintTerm):
    """V = Σ det(a - p, b - p, c - p)/6 over the triangles of each patch, δ = V - V_rest."""

    name, group = "chambers", "actuators"

    def __init__(self, patches: list, apices: list, free_index: np.ndarray, rest: np.ndarray):
        self._patches, self._apices = patches, np.array(apices, float)
        self._free = free_index
        corners = [patch.ravel() for patch in patches]
        free = [free_index[nodes] for nodes in corners]
        self._kept = [index >= 0 for index in free]
        self.entry_nodes = np.concatenate([f[k] for f, k in zip(free, self._kept, strict=True)])
        counts = [int(kept.sum()) for kept in self._kept]
        self.entry_rows = np.repeat(np.arange(len(patches)), counts)
        self.row_count = len(patches)
        self.rest_volumes = self.volumes(rest)
        self.scales = np.abs(self.rest_volumes)

    def _edges(self, index: int, positions: np.ndarray) -> np.ndarray:
        return positions[self._patches[index]] - self._apices[index]

    def volumes(self, positions: np.ndarray) -> np.ndarray:
        return np.array([np.linalg.det(self._edges(i, positions)).sum() / 6.0
                         for i in range(self.row_count)])  # fmt: skip

    def evaluate(self, positions, blocks, values) -> None:
        parts = []
        for index, kept in enumerate(self._kept):
            a, b, c = np.moveaxis(self._edges(index, positions), 1, 0)
            by_corner = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=1) / 6.0
            parts.append(by_corner.reshape(-1, 3)[kept])
        blocks[:] = np.concatenate(parts)
        values[:] = self.volumes(positions) - self.rest_volumes

    def stencils(self) -> np.ndarray:
        return self._free[np.concatenate(self._patches)]

    def bind(self, elimination_rank, slots) -> None:
        self._bound = bind_stencils(self.stencils(), elimination_rank, slots)

    def add_stiffness(self, positions, multipliers, storage, projected=False) -> None:
        """Adds -λ ∂²V: with edges e from the apex, the block of corners k and k + 1 is the matrix
        of the cross product with e of the third corner, over 6."""
        if projected:
            return
        edges = np.concatenate([self._edges(i, positions) for i in range(self.row_count)])
        pressures = np.repeat(multipliers, [len(patch) for patch in self._patches])
        order, offsets, strides = self._bound
        for pair, (row, column) in enumerate(zip(*lower_pairs(3), strict=True)):
            if row == column:
                continue
            first, second = order[:, row], order[:, column]
            third = edges[np.arange(len(edges)), 3 - first - second]
            sign = np.where((first + 1) % 3 == second, 1.0, -1.0)
            cross = np.cross(np.eye(3)[None], third[:, None]).transpose(0, 2, 1)
            blocks = (-sign * pressures / 6.0)[:, None, None] * cross
            kept = offsets[:, pair] >= 0
            for i in range(3):
                for j in range(3):
                    places = offsets[kept, pair] + i + j * strides[kept, pair]
                    np.add.at(storage, places, blocks[kept, i, j])


class ChamberActuator(ActuatorKind):
    """See `ActuatorKind`."""

    section, entry = "chambers", Chamber
    setpoint = Quantity("volume", "m3")
    displacement = Quantity("expansion", "m3")
    effort = Quantity("pressure", "Pa")
    least_setpoint = 0.0

    def build(self, layout, entries, notes) -> ActuatorGroup:
        rest = layout.nodes.rest_positions
        patches = []
        for index, chamber in enumerate(entries):
            body = layout.body_named(chamber.body)
            triangles = body.mesh.surface_triangles + body.first_node
            low, high = chamber.patch.minimum, chamber.patch.maximum
            inside = ((rest[triangles] >= low) & (rest[triangles] <= high)).all(axis=(1, 2))
            if not inside.any():
                raise SceneError(layout.scene.path, f"chambers[{index}].patch", chamber.name, "m",
                                 "holds no triangle of the surface")  # fmt: skip
            # Outside of the body is inside of the chamber.
            patches.append(triangles[inside][:, ::-1])
        term = Chambers(patches, [c.apex for c in entries], layout.nodes.free_index, rest)
        return group_of(
            self, entries, term, term.scales, np.array([c.pressure for c in entries]),
            np.full(len(entries), 0.02 * 0.06), rest_setpoints=term.rest_volumes,
            displacement_bounds=np.array([c.expansion for c in entries]),
        )  # fmt: skip

    def doubts(self, model, group):
        yield from (f"{name} is a chamber" for name in group.names)

    def paths(self, group, positions):
        return ()

    def details(self, entry, group, index) -> str:
        return "a chamber on a patch"


@pytest.fixture
def chambers():
    """The kind, registered for one test."""
    kind = ChamberActuator()
    with taken_back():
        register_actuator(kind)
        yield kind


def chamber(name: str, x: float) -> dict:
    """A chamber beside the beam, which pushes its upper half to the other side."""
    near = sorted([x - 1e-6, x + 1e-6])
    return {
        "name": name, "apex": [1.5 * x - 0.005, 0.01, 0.07],
        "patch": {"minimum": [near[0], -1.0, 0.039], "maximum": [near[1], 1.0, 1.0]},
        "expansion": [-2e-6, 4e-6], "rate": 1e-4, "pressure": [-2e4, 2e4],
    }  # fmt: skip


@builder
def inflated(chambers, beam, /, change=None):
    """Makes the beam with its cables and two chambers; a function may change its scene."""

    def add(mapping):
        mapping["chambers"] = [chamber("left", 0.0), chamber("right", 0.02)]
        mapping["solver"] = {"newton_iterations": 30, "residual_tolerance": 1e-9}
        change_scene(mapping, change)

    return beam(add)


def test_a_section_name_in_use_is_refused():
    class Spring(ChamberActuator):
        section = "springs"

    with pytest.raises(ValueError, match="springs"):
        register_actuator(Spring())
    assert all(kind.section != "springs" for kind in actuator_kinds())


def test_a_scene_names_a_kind_only_while_it_is_registered(beam):
    add = changed({"chambers": [chamber("left", 0.0)]})
    with taken_back():
        register_actuator(ChamberActuator())
        assert beam(add).actuator_names == ("east", "north", "west", "south", "left")
    with pytest.raises(SceneError, match="chambers.*is not a key here"):
        beam(add)


def test_its_entries_are_checked_as_those_of_other_kinds(inflated):
    def spelt_wrong(mapping):
        mapping["chambers"][0]["presure"] = mapping["chambers"][0].pop("pressure")
    with pytest.raises(SceneError, match="presure.*is pressure meant"):
        inflated(spelt_wrong)
    with pytest.raises(SceneError, match="chamber or motor east is given more than once"):
        inflated(changed({"chambers.1.name": "east"}))
    with pytest.raises(SceneError, match="is beam meant"):
        inflated(changed({"chambers.1.body": "bean"}))


def test_it_stands_among_the_actuators_with_its_units(inflated):
    simulation = inflated()
    actuators = simulation.actuators
    assert actuators.names == ("east", "north", "west", "south", "left", "right")
    assert [kind.noun for kind in actuators.kinds] == ["cable"] * 4 + ["chamber"] * 2
    assert [kind.effort.unit for kind in actuators.kinds] == ["N"] * 4 + ["Pa"] * 2
    assert actuators.of_section("chambers") == slice(4, 6)
    assert actuators.row_count == 6 and "chambers" in [t.name for t in simulation.terms]
    # A pyramid of 20 x 60 mm, 5 mm high.
    np.testing.assert_allclose(simulation.rest_setpoints[4:], 0.02 * 0.06 * 0.005 / 3.0)
    assert simulation.notes[-2:] == ("left is a chamber", "right is a chamber")
    assert set(simulation.actuator_paths()) == {"east", "north", "west", "south"}


def test_its_rows_are_the_derivative_of_its_volume(inflated):
    simulation = inflated()
    term = simulation.actuators.terms[1]
    random = np.random.default_rng(3)
    x = simulation.model.nodes.rest_positions.copy()
    x += 1e-3 * random.standard_normal(x.shape)
    blocks, values = np.empty((term.entry_capacity, 3)), np.empty(2)
    term.evaluate(x, blocks, values)
    free = simulation.model.nodes.free_nodes
    move = np.zeros_like(x)
    move[free] = random.standard_normal((len(free), 3))
    by_rows = np.zeros(2)
    np.add.at(by_rows, term.entry_rows, np.sum(blocks * move[free][term.entry_nodes], axis=1))
    h = 1e-6
    slopes = (term.volumes(x + h * move) - term.volumes(x - h * move)) / (2.0 * h)
    np.testing.assert_allclose(by_rows, slopes, rtol=1e-7)


def test_its_geometric_stiffness_is_the_derivative_of_its_rows(inflated):
    simulation = inflated()
    term, factorization = simulation.actuators.terms[1], simulation.model.factorization
    nodes, random = simulation.model.nodes, np.random.default_rng(3)
    x = nodes.rest_positions + 1e-3 * random.standard_normal(nodes.rest_positions.shape)
    move = np.zeros_like(x)
    move[nodes.free_nodes] = random.standard_normal((nodes.free_node_count, 3))
    pressures = np.array([100.0, -300.0])

    def forces(at):
        blocks, found = np.empty((term.entry_capacity, 3)), np.zeros((nodes.free_node_count, 3))
        term.evaluate(at, blocks, np.empty(2))
        np.add.at(found, term.entry_nodes, blocks * pressures[term.entry_rows, None])
        return found

    # With a large diagonal, A⁻¹ of what the stiffness alone does to the move is known.
    h, large = 1e-7, 1e3
    change = (forces(x + h * move) - forces(x - h * move)) / (2.0 * h)
    factorization.clear()
    diagonal, strides = factorization.slots(*[np.arange(nodes.free_node_count)] * 2)
    for i in range(3):
        factorization.storage[diagonal + i * (1 + strides)] += large
    term.add_stiffness(x, pressures, factorization.storage)
    assert factorization.factor()
    solved = factorization.solve(large * move[nodes.free_nodes] - change)
    np.testing.assert_allclose(solved, move[nodes.free_nodes], atol=1e-9)


def test_it_reaches_a_volume_and_the_same_pressure_holds_it_there(inflated, settle):
    simulation = inflated()
    volumes = simulation.rest_setpoints.copy()
    volumes[4] += 4e-7
    result = settle(simulation, CommandSetpoints(volumes, 1.0))
    assert result.status is Status.OK
    term = simulation.actuators.terms[1]
    np.testing.assert_allclose(term.volumes(result.state.positions), volumes[4:], rtol=1e-9)
    np.testing.assert_allclose(result.displacements[4:], [4e-7, 0.0], rtol=1e-6, atol=1e-15)
    # Blown up, it pushes the beam away; the other one, which keeps its volume, pushes back.
    assert result.efforts[4] > result.efforts[5] > 0.0


def test_it_brings_an_effector_to_its_target_together_with_cables(inflated):
    simulation = inflated()
    target = simulation.effector_positions() + [0.006, 0.001, -0.001]
    result = solved(simulation, FollowTargets(target, STEP), 60)
    assert result.effector_errors[0] < 1e-4
    assert np.abs(result.efforts[4:]).max() > 1.0


def test_a_state_with_it_is_complete(inflated):
    simulation = inflated()
    volumes = simulation.rest_setpoints.copy()
    volumes[4] += 5e-7
    simulation.step(CommandSetpoints(volumes, STEP))
    state = simulation.state
    one = simulation.step(Hold(STEP))
    simulation.restore(state)
    other = simulation.step(Hold(STEP))
    assert one.efforts.tobytes() == other.efforts.tobytes()
    assert one.setpoints.tobytes() == other.setpoints.tobytes()


def test_files_name_its_quantities_and_units(inflated, tmp_path):
    simulation = inflated()
    header = RunColumns(simulation).names
    assert header[header.index("left_volume_m3") :][:4] == (
        "left_volume_m3", "left_pressure_Pa", "left_expansion_m3", "left_rest_volume_m3")
    assert header[header.index("east_length_m") :][:5] == (
        "east_length_m", "east_tension_N", "east_shortening_m", "east_rest_length_m",
        "east_path_m")
    result = simulation.step(Hold(STEP))
    cells = actuator_cells(result, simulation.actuators)
    assert cells[20] == result.setpoints[4] and cells[21] == result.efforts[4]


def test_a_file_of_targets_drives_it_by_volume_or_pressure(inflated, tmp_path):
    simulation = inflated(lambda mapping: mapping.update(cables=[]))
    path = tmp_path / "targets.csv"
    path.write_text("time_s,left_volume_m3,right_volume_m3\n0,2e-6,2e-6\n1,2.1e-6,2e-6\n")
    rows = read_targets(path, simulation)
    assert isinstance(rows.command(1), CommandSetpoints)
    np.testing.assert_array_equal(rows.command(1).setpoints, [2.1e-6, 2e-6])
    path.write_text("time_s,left_pressure_Pa,right_pressure_Pa\n0,100,-100\n")
    rows = read_targets(path, simulation)
    assert isinstance(rows.command(0), CommandEfforts)
    path.write_text("time_s,left_volume_m3,right_volume_m3\n0,2e-6,-1e-6\n")
    with pytest.raises(TableFileError, match="right_volume_m3 = -1e-06 m3"):
        read_targets(path, simulation)


def test_explain_lists_it_with_its_units(inflated):
    simulation = inflated()
    told = {effect.entry: (effect.content, effect.result) for effect in effects(simulation)}
    asked, made = told["chambers: left"]
    assert asked == ("a chamber on a patch, expansion [-2, 4] cm³, "
                     "pressure [-20, 20] kPa, rate 100 cm³/s")  # fmt: skip
    assert made == "term chambers"
    assert "shortening [0, 20] mm, tension [0, 40] N" in told["cables: east"][0]
