"""The allowed imports between the package's folders, checked in every module's source."""

import ast
import re
import subprocess
import sys
from collections.abc import Callable
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import NamedTuple

import pytest

from test.places import PACKAGE, ROOT

MODULES = sorted(PACKAGE.rglob("*.py"))

CORE = {"geometry", "mechanics", "constraints", "solvers", "scene", "simulation"}
BELOW_CONTROL = CORE | {"analysis", "tables"}
# Rooms that each room may import, besides itself, the kernels and the files at the top.
ALLOWED_ROOMS = {
    "kernels": set(),
    "geometry": set(),
    "mechanics": {"geometry"},
    "constraints": {"geometry", "mechanics"},
    "solvers": set(),
    # Names of what is registered there: laws and factorizations; where a helix begins.
    "scene": {"geometry", "mechanics", "solvers"},
    "simulation": CORE - {"simulation"},
    "analysis": CORE, "tables": CORE | {"analysis"},
    # The quadratic program of predictive control, and lengths of vectors.
    "control": {"analysis", "geometry", "simulation", "solvers", "tables"},
    "view": {"mechanics", "simulation"},
    "record": BELOW_CONTROL | {"control"},
    "ros": BELOW_CONTROL | {"control", "view", "record"},
    "harness": BELOW_CONTROL,
    "reduction": BELOW_CONTROL | {"harness"},
    "calibration": BELOW_CONTROL | {"control", "harness", "record"},
    "study": BELOW_CONTROL | {"control", "harness", "reduction", "view"},
    "scripting": BELOW_CONTROL | {"calibration", "control", "harness", "study", "view"},
    # It builds what it writes, and prints as studies do.
    "conversion": {"geometry", "harness", "scene", "simulation", "study"},
    "command_line": BELOW_CONTROL | {
        "calibration", "control", "conversion", "harness", "record", "reduction", "ros", "study", "view"},
}
# Rooms inside the simulation, each of which imports only those before it and its vocabulary. The other
# files at the top of the simulation put these rooms together.
STEP_ROOMS = ("building", "step", "effects")
VOCABULARY = {"command", "contact_forces", "result", "state"}
ENTRANCE = {"__init__.py", "__main__.py", "errors.py", "shared_files.py"}
# Where a library may be imported; gmsh only in the process that meshes CAD files.
HOMES = {
    "rerun": {"view"}, "matplotlib": {"harness", "study"}, "mpl_toolkits": {"study"}, "gmsh": {"geometry"},
    "daqp": {"solvers"}, "mcap": {"record"}, "trimesh": {"geometry"}, "manifold3d": {"geometry"}}
ROS_LIBRARIES = {"rclpy", "rpyutils", "ament_index_python", "std_srvs", "builtin_interfaces"}
ROS_SUFFIXES = ("_msgs", "_interfaces")
DOTTED_NAME = re.compile(r"\w+(\.\w+)*")
# Our own modules that are imported inside functions, by the file that does, and why they wait.
LATER_IMPORTS = {
    "__init__.py": "a node listens to signals before it imports the simulation",
    "__main__.py": "only a node loads the room of nodes",
    "command_line/commands.py": "a command loads only what it runs",
    "control/mesh_error_watch.py": "numpy must be imported after the process has lowered its "
                                   "priority, because threads of its libraries inherit it",
    "control/reduction_error_watch.py": "as control/mesh_error_watch.py",
    "conversion/prefabs.py": "as conversion/stand_ins.py",
    "conversion/scene_process.py": "as conversion/stand_ins.py",
    "conversion/stand_ins.py": "a scene that reads no values imports neither scipy nor numba",
    "ros/process.py": "a node listens to signals before rclpy and the node's room are imported",
    "ros/twin_node.py": "only a recorded run loads the room that writes it",
    "view/mirror.py": "only an open view needs rerun",
}


class Import(NamedTuple):
    """One import.

    Attributes:
        module: Absolute dotted name of the imported module.
        line: Line number.
        lazy: It is inside a function, so importing the file does not run it.
    """

    module: str
    line: int
    lazy: bool


@cache
def read_imports(path: Path) -> list[Import]:
    """All imports of a module, also those inside functions and those by name."""
    tree = ast.parse(path.read_text(), str(path))
    found = [Import(name, node.lineno, lazy)
             for node, lazy in statements(tree) for name in imported_names(node, path)]
    if {"importlib", "importlib.import_module"} & {item.module for item in found}:
        # A name that is imported may come from a table: every string of its form counts.
        found += [Import(node.value, node.lineno, lazy=True) for node in ast.walk(tree)
                  if isinstance(node, ast.Constant) and isinstance(node.value, str)
                  and DOTTED_NAME.fullmatch(node.value)]
    return found


def statements(tree: ast.AST) -> list[tuple[ast.AST, bool]]:
    """Every statement below, and whether it is inside a function."""
    found, left = [], [(tree, False)]
    while left:
        node, lazy = left.pop()
        lazy |= isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
        for name in ("body", "orelse", "finalbody", "handlers", "cases"):
            below = getattr(node, name, ())
            if isinstance(below, list):  # a lambda's body is one expression
                found += [(child, lazy) for child in below]
                left += [(child, lazy) for child in below]
    return found


def imported_names(node: ast.AST, path: Path) -> list[str]:
    """Absolute names that a statement brings in."""
    if isinstance(node, ast.Import):
        return [alias.name for alias in node.names]
    if isinstance(node, ast.ImportFrom):
        base = node.module or ""
        if node.level:
            package = path.relative_to(ROOT).parts[:-node.level]
            base = ".".join([*package, *base.split(".")] if base else package)
        # "from package import module" may name a module: the longest name is judged.
        return [f"{base}.{alias.name}" for alias in node.names]
    return []


def room_of(module: str) -> str:
    """Room, or file at the top, of one of our modules; an empty name for another's."""
    package, _, rest = module.partition(".")
    return rest.split(".")[0] if package == PACKAGE.name else ""


def place_of(path: Path) -> str:
    """Room of a file, or an empty name for one at the top of the package."""
    parts = path.relative_to(PACKAGE).parts
    return parts[0] if len(parts) > 1 else ""


def is_ros(library: str) -> bool:
    return library in ROS_LIBRARIES or library.endswith(ROS_SUFFIXES) or library.startswith("rcl")


def violations(broken: Callable[[Path, Import], bool]) -> list[str]:
    """Imports that break a rule, as "file:line imports module"."""
    return [f"{path.relative_to(PACKAGE)}:{found.line} imports {found.module}"
            for path in MODULES for found in read_imports(path) if broken(path, found)]


def test_a_room_imports_only_the_rooms_it_may():
    everywhere = {name.removesuffix(".py") for name in ENTRANCE} | {"kernels"}

    def broken(path, found):
        room, other = place_of(path), room_of(found.module)
        return room and other and other not in ALLOWED_ROOMS[room] | {room} | everywhere
    assert violations(broken) == []


def test_rooms_inside_the_simulation_are_imported_one_way():
    def broken(path, found):
        parts, names = path.relative_to(PACKAGE).parts, found.module.split(".")[1:]
        if parts[0] != "simulation" or len(parts) < 3 or names[:1] != ["simulation"]:
            return False
        return names[1] not in {*STEP_ROOMS[: STEP_ROOMS.index(parts[1]) + 1], *VOCABULARY}
    assert violations(broken) == []
    assert {path.parent.name for path in (PACKAGE / "simulation").glob("*/__init__.py")} == set(STEP_ROOMS)


def test_nobody_imports_the_room_for_users_but_the_entrance_of_the_package():
    def broken(path, found):
        return room_of(found.module) == "scripting" and place_of(path) not in ("", "scripting")
    assert violations(broken) == []


def module_name(path: Path) -> str:
    """Dotted name of a file; that of the folder for an ``__init__.py``."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imported_modules() -> dict[str, set[str]]:
    """Modules of ours that each of ours imports: at its top, later, or for types alone."""
    names = {module_name(path) for path in MODULES}
    graph = {}
    for path in MODULES:
        modules = {found.module if found.module in names else found.module.rpartition(".")[0]
                   for found in read_imports(path)}
        graph[module_name(path)] = modules & names
    return graph


def test_no_modules_import_each_other_in_a_circle():
    try:
        list(TopologicalSorter(imported_modules()).static_order())
    except CycleError as error:
        raise AssertionError(" -> ".join(error.args[1])) from None


def test_our_own_modules_are_imported_at_the_top_of_a_file_but_for_those_that_wait_for_a_reason():
    assert set(LATER_IMPORTS) == {place(path) for path in MODULES for found in read_imports(path)
                                  if found.lazy and room_of(found.module)}


def place(path: Path) -> str:
    """A file's path inside the package."""
    return path.relative_to(PACKAGE).as_posix()


def test_a_library_stays_in_its_room():
    def broken(path, found):
        library = found.module.split(".")[0]
        home = {"ros"} if is_ros(library) else HOMES.get(library)
        return home is not None and place_of(path) not in home
    assert violations(broken) == []


IMPORTS = """
import importlib, os, sys

def load(names):
    for name in names.split():
        importlib.import_module(name)

load({both!r})
child = os.fork()
if child == 0:
    load({without_ros!r})
    print(*sys.modules)
    sys.exit()
if os.waitpid(child, 0)[1]:
    sys.exit("the modules without ROS cannot be imported")
load({without_view!r})
print(*sys.modules)
"""


@pytest.fixture(scope="module")
def loaded_modules() -> tuple[set[str], set[str]]:
    """All modules that a fresh interpreter has once it has imported all of ours but the nodes and
    the commands that start them, and all but the view.

    What both import is imported once, before the interpreter becomes two.
    """
    def names(wanted: Callable[[Path], bool]) -> str:
        return " ".join(module_name(path) for path in MODULES
                        if path.name != "__init__.py" and wanted(path))

    def has_no_ros(path):
        return place_of(path) not in ("ros", "command_line") and path.name != "__main__.py"

    def has_no_view(path):
        return place_of(path) != "view"
    code = IMPORTS.format(both=names(lambda path: has_no_ros(path) and has_no_view(path)),
                          without_ros=names(has_no_ros), without_view=names(has_no_view))
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    without_ros, without_view = done.stdout.splitlines()
    return set(without_ros.split()), set(without_view.split())


@pytest.mark.libraries
def test_only_an_open_view_loads_rerun_and_only_a_picture_matplotlib(loaded_modules):
    _, loaded = loaded_modules
    assert {"softrobot_twin.simulation", "softrobot_twin.study", "softrobot_twin.ros"} <= loaded
    assert not loaded & {"rerun", "matplotlib", "gmsh", "trimesh", "manifold3d"}


def test_only_nodes_and_the_commands_that_start_them_load_ros(loaded_modules):
    loaded, _ = loaded_modules
    assert {"softrobot_twin.simulation", "softrobot_twin.study"} <= loaded
    assert not {name for name in loaded if is_ros(name.split(".")[0])}
    assert "softrobot_twin.ros" not in loaded


# What a load with its first step imports: libraries, and rooms of scipy. Some come with another one:
# rich with meshio, coverage with numba where it is installed.
LOADED_BY_A_STEP = {
    "annotated_types", "charset_normalizer", "colorama", "coverage", "cython_runtime", "daqp",
    "llvmlite", "meshio", "numba", "numpy", "pydantic", "pydantic_core", "rich",
    "scipy", "scipy.constants", "scipy.linalg", "scipy.sparse", "scipy.spatial", "scipy.special",
    "scipy.version", "softrobot_twin", "typing_extensions", "typing_inspection", "yaml"}
LOAD = """
import sys
print(*sys.modules)
import softrobot_twin
print(*sys.modules)
softrobot_twin.load("config/scenes/diamond.yaml").step()
print(*sys.modules)
"""


def test_a_load_and_a_step_import_only_the_libraries_that_they_need():
    done = subprocess.run([sys.executable, "-W", "ignore", "-c", LOAD], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    started, imported, stepped = (set(line.split()) for line in done.stdout.splitlines())
    rooms = {".".join(name.split(".")[:1 + name.startswith("scipy.")]) for name in stepped - started}
    known = LOADED_BY_A_STEP | sys.stdlib_module_names
    assert {room for room in rooms if not room.startswith(("_", "scipy._"))} <= known
    assert not (imported - started) & {"numpy", "numba", "softrobot_twin.simulation"}
