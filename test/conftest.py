"""Environment of all tests, set before numpy, rclpy, numba or rerun is first imported."""

import itertools
import os
import runpy
import secrets
import sys
import time
import zlib
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

import softrobot_twin  # noqa: F401  chooses threads; before numpy

# Tests start hundreds of processes, each of which would compile all sources anew.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False
# With this, rclpy checks the types of message fields; otherwise wrong types are sent as garbage.
os.environ["ROS_PYTHON_CHECK_FIELDS"] = "1"
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
# A wrong shape is an error, not a warning.
os.environ["RERUN_STRICT"] = "1"

from numba.core.dispatcher import Dispatcher  # noqa: E402


# Marks of a test (pytest.ini says what each is for): `exhaustive` is left to `make test-all`. Those
# are long runs, finer meshes, other robots, studies and pictures: a shorter test holds each of them
# to the same bar, or the change that would break them breaks tests of their parts. Of a test that
# is `sampled`, `make test` takes one case in five; of one with more seeds, the first of them.
SEEDS = 2


def is_left_out(item, drawn: Counter) -> bool:
    """Whether `make test` leaves out a case for being one of many.

    Args:
        item: The case.
        drawn: Cases so far of each test, and of each of its cases but for the seed; is changed.
    """
    # `callspec.indices` number the cases where parameters are stacked, and not each parameter.
    values = item.callspec.params if hasattr(item, "callspec") else {}
    places = {name: id(value) for name, value in values.items()}
    same = (item.path, item.originalname)
    if places.pop("seed", None) is not None:
        drawn[*same, *places.items()] += 1
        if drawn[*same, *places.items()] > SEEDS:
            return True
    drawn[same] += 1
    return item.get_closest_marker("sampled") is not None and drawn[same] % 5 != 1


def pytest_ignore_collect(collection_path, config):
    """Where only `libraries` are wanted, files without such tests are not even read."""
    is_test = collection_path.name.startswith("test_") and collection_path.suffix == ".py"
    if is_test and config.option.markexpr.startswith("libraries"):
        return True if "pytest.mark.libraries" not in collection_path.read_text() else None
    return None


def pytest_collection_modifyitems(items):
    """Marks as `exhaustive` what `make test` leaves out of a test of many cases.

    The longest, which have a limit of their own, begin first: at the end, one would run alone.
    """
    drawn = Counter()
    for item in items:
        if is_left_out(item, drawn):
            item.add_marker(pytest.mark.exhaustive)
    items.sort(key=lambda item: item.get_closest_marker("timeout") is None)


# Processor time [s] that a case of `make test` may take, with its own fixtures and processes.
BUDGET = 1.0
# A case fails beyond this many budgets, so that neither noise nor a busy machine fails it.
SLACK = 8.0
# Processor time [s] of `calibration_loop` on the machine (AMD Zen 4) on which budgets are kept.
CALIBRATION = 0.036
_BEGAN = pytest.StashKey[float]()
_uncounted, _pauses = 0.0, 0


def counted_time() -> float:
    """Processor time of this process and its ended children [s], but for what is not counted."""
    return sum(os.times()[:4]) - _uncounted


@contextmanager
def not_counted() -> Iterator[None]:
    """Leaves out of the time of a case what is done only because the case is the first."""
    global _uncounted, _pauses
    began, _pauses = sum(os.times()[:4]), _pauses + 1
    try:
        yield
    finally:
        _pauses -= 1
        if not _pauses:
            _uncounted += sum(os.times()[:4]) - began


def calibration_loop() -> float:
    """Processor time [s] of a fixed amount of work."""
    began = time.process_time()
    sum(number * number % 7 for number in range(500_000))
    return time.process_time() - began


# Kernels are compiled or read from the disk once, by whichever case needs them first.
Dispatcher.compile = not_counted()(Dispatcher.compile)


@pytest.hookimpl(wrapper=True)
def pytest_fixture_setup(fixturedef):
    if fixturedef.scope == "function":
        return (yield)
    with not_counted():
        return (yield)


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_setup(item):
    item.stash[_BEGAN] = counted_time()
    return (yield)


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_call(item):
    result = yield
    took = counted_time() - item.stash[_BEGAN]
    item.user_properties.append(("processor_time", took))
    if item.get_closest_marker("exhaustive") is None and took > SLACK * BUDGET:
        slowness = max(1.0, calibration_loop() / CALIBRATION)
        assert took < SLACK * BUDGET * slowness, (
            f"{item.nodeid} took {took:.1f} s of processor time; a case of `make test` may take "
            f"{BUDGET:g} s. Make it shorter, share what it builds in a fixture of its module, or "
            "mark it `exhaustive` and leave a shorter case of the same claim.")
    return result


def pytest_terminal_summary(terminalreporter):
    """Prints what the cases took in all, and those above the budget."""
    took = sorted(((dict(report.user_properties)["processor_time"], report.nodeid)
                   for report in terminalreporter.stats.get("passed", ())
                   if report.when == "call"), reverse=True)  # fmt: skip
    terminalreporter.write_line(
        f"Processor time of {len(took)} cases: {sum(each for each, _ in took):.0f} s.")
    for each, case in took:
        if each > BUDGET:
            terminalreporter.write_line(f"  {each:.1f} s {case}")


def domains_in_turn() -> Callable[[], int]:
    """Yields ROS domains 1 to 100, starting at a different one in each test process.

    A node that was killed stays in the graph of its domain for a while; when the turn comes to
    that domain again, it is long forgotten.
    """
    worker = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw"))
    turns = itertools.count(os.getpid() + 50 * worker)
    return lambda: 1 + next(turns) % 100


next_domain = domains_in_turn()


@pytest.fixture(scope="session")
def ros_domain() -> Callable:
    """Makes contexts that hold a ROS domain which no other test on this machine uses meanwhile."""
    from domain_coordinator import domain_id

    return lambda: domain_id(next_domain)


@pytest.fixture
def ros_domain_id(ros_domain):
    """A ROS domain that no other test on this machine uses at the same time."""
    with ros_domain() as number:
        yield number


@pytest.fixture(scope="session")
def block() -> Callable:
    """Makes a box of cells, six tetrahedra each, with its inner nodes moved about."""

    import numpy as np

    from softrobot_twin.geometry.tet_mesh import TetMesh

    # Odd permutations give mirrored tetrahedra, so two nodes are swapped.
    paths = [(path, np.linalg.det(np.eye(3)[list(path)]) > 0) for path in itertools.permutations(range(3))]

    def make(size=(0.2, 0.3, 0.4), cells=(2, 3, 4), shake=0.2) -> TetMesh:
        counts = np.array(cells) + 1
        grid = np.array(list(itertools.product(*(range(count) for count in counts))), float)
        inner = ((grid > 0) & (grid < counts - 1)).all(axis=1)
        grid[inner] += np.random.default_rng(1).uniform(-shake, shake, (inner.sum(), 3))
        index = np.arange(len(grid)).reshape(counts)
        tets = []
        for cell in itertools.product(*(range(count) for count in cells)):
            for path, even in paths:
                corner = list(cell)
                tet = [index[cell]]
                for axis in path:
                    corner[axis] += 1
                    tet.append(index[tuple(corner)])
                tets.append(tet if even else [tet[0], tet[2], tet[1], tet[3]])
        return TetMesh(grid * np.array(size) / np.array(cells), np.array(tets))

    return make


_COLUMN_SCENE = """
name: column
gravity: [0.0, 0.0, -9.81]
body:
  mesh: {file: column.vtk}
  element: linear
  material: {law: corotational, young_modulus: 200.0e3, poisson_ratio: 0.4, density: 1070.0}
  fixed:
    - box: {minimum: [-1.0, -1.0, -0.001], maximum: [1.0, 1.0, 0.001]}
cables:
"""
_COLUMN_CABLE = """
  - name: %s
    pull_point: [%s, %s, -0.02]
    points: [[%s, %s, 0.05], [%s, %s, 0.10]]
    shortening: [0.0, 0.02]
    tension: [0.0, 10.0]
"""
_COLUMN_EFFECTOR = """
effectors:
  - name: tip
    points: [[0.01, 0.01, 0.10]]
"""


@pytest.fixture(scope="session")
def column(tmp_path_factory, block) -> Path:
    """Scene file of a column, 20 × 20 × 100 mm, held at its foot."""
    import meshio

    folder = tmp_path_factory.mktemp("scene")
    mesh = block(size=(0.02, 0.02, 0.1), cells=(2, 2, 5), shake=0.0)
    meshio.Mesh(mesh.node_positions, [("tetra", mesh.cells)]).write(folder / "column.vtk")
    corners = {"a": (0.0, 0.0), "b": (0.02, 0.0), "c": (0.02, 0.02), "d": (0.0, 0.02)}
    cables = "".join(_COLUMN_CABLE % (name, *3 * corner) for name, corner in corners.items())
    scene = folder / "column.yaml"
    scene.write_text(_COLUMN_SCENE + cables + _COLUMN_EFFECTOR)
    return scene


@pytest.fixture(scope="session")
def air_scene(block, tmp_path_factory) -> dict:
    """An upright soft block with three cavities and a cable.

    `low` and `high` are commanded by pressure, `high` may be evacuated; `syringe` is commanded by
    volume.
    """
    import meshio
    import numpy as np

    from softrobot_twin.geometry.surface import boundary_triangles

    folder = tmp_path_factory.mktemp("air")
    cells, size = (4, 4, 10), (0.02, 0.02, 0.1)
    mesh = block(size, cells, 0.0)
    middle = mesh.node_positions[mesh.cells].mean(axis=1) * cells / size
    across = (np.abs(middle[:, :2] - 2.0) < 1.0).all(axis=1)
    hollow = np.zeros(len(mesh.cells), bool)
    for name, foot in (("low", 1.0), ("high", 4.0), ("syringe", 7.0)):
        inside = across & (middle[:, 2] > foot) & (middle[:, 2] < foot + 2.0)
        triangles = boundary_triangles(mesh.cells[inside])
        points = meshio.Mesh(mesh.node_positions, [("triangle", triangles)])
        meshio.write(folder / f"{name}.vtk", points)
        hollow |= inside
    used, index = np.unique(mesh.cells[~hollow], return_inverse=True)
    body = meshio.Mesh(mesh.node_positions[used], [("tetra", index.reshape(-1, 4))])
    meshio.write(folder / "body.vtk", body)

    def cavity(name, **entries) -> dict:
        return {"name": name, "walls": [{"file": str(folder / f"{name}.vtk")}], **entries}

    return {
        "name": "air",
        "gravity": [0.0, 0.0, -9.81],
        "body": {
            "mesh": {"file": str(folder / "body.vtk")}, "element": "linear",
            "material": {"young_modulus": 1e5, "poisson_ratio": 0.3, "density": 1000.0},
            "fixed": [{"box": {"minimum": [-1, -1, -1], "maximum": [1, 1, 1e-6]}}],
        },
        "cavities": [
            cavity("low", pressure=[0.0, 2.0e4], rate=2.0e4),
            cavity("high", pressure=[-5.0e3, 1.0e4], rate=1.0e4),
            cavity("syringe", control="volume", growth=[-4.0e-7, 1.0e-6], rate=1.0e-6),
        ],
        "cables": [{
            "name": "east", "pull_point": [0.02, 0.01, 0.0], "points": [[0.02, 0.01, 0.1]],
            "shortening": [0.0, 0.01], "rate": 0.02, "tension": [0.0, 10.0],
        }],
        "effectors": [{"name": "top", "points": [[0.01, 0.01, 0.1]], "directions": ["z"],
                       "measured_by": [1]}],
        "markers": [{"id": 1, "point": [0.01, 0.01, 0.1]}],
        "solver": {"newton_iterations": 3, "residual_tolerance": 1e-5},
    }  # fmt: skip


@pytest.fixture(scope="session")
def half_trained(tmp_path_factory) -> Path:
    """Scene file of a small Diamond whose reduced body was trained on half of what its cables wind.

    It has 24 modes in use and 24 spare ones, of 128 equilibria with each cable wound by up to 11 mm.
    """
    import numpy as np

    from softrobot_twin.harness.sampled_axes import sampled_axes
    from softrobot_twin.reduction.body_training import reduction_of, train
    from softrobot_twin.reduction.reduction_basis import rest_stiffness
    from softrobot_twin.reduction.reduction_states import (
        Sampling,
        StateFinder,
        chains,
        joined,
        samples_of,
        spread_of,
        training_scene,
    )
    from softrobot_twin.reduction.training_options import TrainingOptions
    from softrobot_twin.scene import load_scene
    from softrobot_twin.simulation.building.reduced_body import (
        reduction_fingerprints,
        write_body_reduction,
    )
    from test.scene_changes import entries_of, yaml_file

    root, folder = Path(__file__).parents[1], tmp_path_factory.mktemp("half_trained")
    mapping = entries_of(root / "config/scenes/diamond.yaml",
                         {"body.mesh.file": str(root / "meshes/diamond_150.vtk"), "body.element": "linear"})
    scene = yaml_file(folder / "scene.yaml", mapping)
    sampling = Sampling("body")
    finder = StateFinder(training_scene(load_scene(scene), sampling), "body")
    names = [cable["name"] for cable in mapping["cables"]]
    axes = sampled_axes(finder.simulation, [f"{name}_shortening_m=0:0.011" for name in names])
    samples = samples_of(finder.simulation, axes, sampling, (), 128, 0, True)
    states = joined([finder(samples[tour]) for tour in chains(samples, spread_of(samples))])
    body = finder.simulation.model.bodies[0]
    trained = train(body, rest_stiffness(body), states, 24, TrainingOptions(spare=24), 0.003)
    reduction = reduction_of(body, trained, np.full(2, np.nan), {})
    write_body_reduction(folder / "body.npz", reduction, reduction_fingerprints(body))
    mapping["body"]["reduced"] = {"file": "body.npz"}
    return yaml_file(scene, mapping)


@pytest.fixture(autouse=True)
def _own_state(tmp_path_factory, monkeypatch):
    """No test continues from the last command of another one, or of a real robot."""
    home = tmp_path_factory.getbasetemp() / f"state_{next(_STATES)}"
    monkeypatch.setenv("XDG_STATE_HOME", str(home))


_STATES = itertools.count()


@pytest.fixture
def drawn_seed(request):
    """A seed of each case of a run, from a drawn number, which is printed; `DRAWN_SEED` sets that number."""
    number = os.environ.get("DRAWN_SEED") or secrets.randbelow(2**32)
    print(f"DRAWN_SEED={number}")
    return zlib.crc32(f"{number} {request.node.nodeid}".encode())


@pytest.fixture
def drawn_rng(drawn_seed):
    """A generator of random numbers from `drawn_seed`."""
    import numpy as np

    return np.random.default_rng(drawn_seed)


@pytest.fixture
def fatigue(monkeypatch):
    """Adds an effect from a file outside of the package to all scenes."""
    from softrobot_twin.simulation.effects.effects import EFFECTS

    effect = runpy.run_path(Path(__file__).with_name("fatigue_effect.py"))["Fatigue"]
    monkeypatch.setattr("softrobot_twin.simulation.effects.effects.EFFECTS",
                        [*EFFECTS, lambda model: [effect(model)]])  # fmt: skip
