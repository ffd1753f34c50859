"""Each name that the package takes from a library is there, and takes the arguments it is given.

It is looked at without calling anything, so that no name is forgotten when a version renames it.
"""

import ast
import contextlib
import importlib.util
import inspect
import sys
from functools import cache
from pathlib import Path
from types import ModuleType

import pytest

import softrobot_twin

pytestmark = pytest.mark.libraries

PACKAGE = Path(softrobot_twin.__file__).parent
# Of newer or older versions, and each used only where it is there and can do what is asked of it.
BY_VERSION = {
    "rerun.Scalar", "rerun.Scalars", "rerun.SeriesLine", "rerun.SeriesLines", "rerun.new_recording",
    "rerun.GrpcServerSink", "rerun.ChunkBatcherConfig", "rerun.blueprint.TimePanel",
}  # fmt: skip


def imported_names(nodes: list[ast.AST]) -> dict[str, str]:
    """Full name of what each name of a module stands for, of those that are imported."""
    names = {}
    for node in nodes:
        if isinstance(node, ast.Import):
            for alias in node.names:
                whole = alias.name if alias.asname else alias.name.partition(".")[0]
                names[alias.asname or whole] = whole
        elif isinstance(node, ast.ImportFrom) and not node.level:
            names |= {alias.asname or alias.name: f"{node.module}.{alias.name}"
                      for alias in node.names}  # fmt: skip
    return names


def dotted_name(node: ast.AST) -> str:
    """"a.b.c" of such an expression; an empty name of another."""
    if isinstance(node, ast.Name):
        return node.id
    if isinstance(node, ast.Attribute) and (before := dotted_name(node.value)):
        return f"{before}.{node.attr}"
    return ""


def is_library(name: str) -> bool:
    return name.partition(".")[0] not in {*sys.stdlib_module_names, PACKAGE.name}


@pytest.fixture(scope="module")
def uses() -> list[tuple[str, str, ast.Call | None]]:
    """Where something of a library is named, its full name, and the call of it if it is one.

    The libraries are imported.
    """
    all_uses = []
    for path in sorted(PACKAGE.rglob("*.py")):
        nodes = list(ast.walk(ast.parse(path.read_text(), str(path))))
        names = {name: whole for name, whole in imported_names(nodes).items() if is_library(whole)}
        calls = {id(node.func): node for node in nodes if isinstance(node, ast.Call)}
        for node in nodes:
            first, _, rest = dotted_name(node).partition(".")
            if first in names:
                where = f"{path.relative_to(PACKAGE)}:{node.lineno}"
                name = f"{names[first]}.{rest}".rstrip(".")
                all_uses.append((where, name, calls.get(id(node))))
    for _, name, _ in all_uses:
        with contextlib.suppress(AttributeError, ImportError):
            found(name)
    return all_uses


@cache
def found(name: str):
    """What a full name stands for; AttributeError or ImportError where there is nothing."""
    first, *rest = name.split(".")
    thing = importlib.import_module(first)
    for position, part in enumerate(rest, 2):
        if isinstance(thing, ModuleType) and not hasattr(thing, part):
            importlib.import_module(".".join([first, *rest][:position]))
        thing = getattr(thing, part)
    return thing


def test_every_name_that_is_taken_from_a_library_is_there(uses):
    lost, libraries = set(), {name.partition(".")[0] for _, name, _ in uses}
    # dask is an extra, and not all of ROS has a wheel; others are declared (test_package.py).
    absent = {library for library in libraries & {"distributed", "tf2_msgs"}
              if importlib.util.find_spec(library) is None}  # fmt: skip
    for where, name, _ in uses:
        if name.partition(".")[0] not in absent and name not in BY_VERSION:
            try:
                found(name)
            except (AttributeError, ImportError):
                lost.add(f"{where} {name}")
    assert not lost


def arguments(call: ast.Call) -> tuple[list[None], dict[str, None]] | None:
    """Stand-ins for the arguments of a call; None where it unpacks some."""
    if any(isinstance(value, ast.Starred) for value in call.args):
        return None
    if any(keyword.arg is None for keyword in call.keywords):
        return None
    return [None] * len(call.args), {keyword.arg: None for keyword in call.keywords}


@cache
def signature_of(name: str) -> inspect.Signature:
    thing = found(name)
    signature = inspect.signature(thing)
    parameters = list(signature.parameters.values())
    # Some classes that are not written in Python tell the object to be made, too.
    made = isinstance(thing, type) and parameters[:1] and parameters[0].name == "self"
    return signature.replace(parameters=parameters[1:]) if made else signature


def test_functions_of_libraries_take_the_arguments_they_are_given(uses):
    refused, judged = set(), set()
    for where, name, call in uses:
        given = arguments(call) if call is not None else None
        if given is None or name in BY_VERSION:
            continue
        try:
            signature = signature_of(name)
        except (AttributeError, ImportError, TypeError, ValueError):
            continue  # compiled: it tells nothing; or not there, which the test above tells
        judged.add(name)
        try:
            signature.bind(*given[0], **given[1])
        except TypeError as error:
            refused.add(f"{where} {name}: {error}")
    assert not refused
    assert {"numpy.linalg.norm", "scipy.sparse.linalg.splu", "matplotlib.pyplot.figure"} <= judged
