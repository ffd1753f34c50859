"""Docstrings: what a public function takes is told, in its own docstring or where it says.

Kernels of one file share arguments, which the file may tell once for all. That shapes of all arrays
are told test_compilation.py checks.
"""

import ast
import re
from functools import cache
from pathlib import Path
from typing import NamedTuple

from test.places import PACKAGE

SEE = re.compile(r"\b[Ss]ee `([\w.]+)`|\b[Aa]s (?:of|in|with|for) `([\w.]+)`")
ENTRY = re.compile(r"^ {4}(\w+(?:, \w+)*): ", re.MULTILINE)
ELSEWHERE = re.compile(r"are as in `(\w+)`")
AS_THERE = re.compile(r"`(\w+)`; see there")


class Function(NamedTuple):
    """A public function or method.

    Attributes:
        path: Its file below the package.
        owner: Its class; None for a function of a file.
        node: Its definition.
    """

    path: Path
    owner: ast.ClassDef | None
    node: ast.FunctionDef

    @property
    def name(self) -> str:
        return f"{self.owner.name}.{self.node.name}" if self.owner else self.node.name

    @property
    def text(self) -> str:
        return ast.get_docstring(self.node) or ""

    @property
    def takes(self) -> list[str]:
        """Names of its arguments."""
        given = self.node.args
        named = [each.arg for each in (*given.posonlyargs, *given.args, *given.kwonlyargs)]
        return [each for each in named if each not in ("self", "cls")] + [
            each.arg for each in (given.vararg, given.kwarg) if each]

    @property
    def decorators(self) -> set[str]:
        return {ast.unparse(each).partition("(")[0] for each in self.node.decorator_list}


def functions(path: Path, body: list, owner: ast.ClassDef | None = None) -> list[Function]:
    found = []
    for node in body:
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            found += functions(path, node.body, node)
        elif isinstance(node, ast.FunctionDef) and not node.name.startswith("_"):
            if any(ast.unparse(each).endswith(".setter") for each in node.decorator_list):
                continue  # The property tells.
            found.append(Function(path, owner, node))
    return found


@cache
def trees() -> dict[Path, ast.Module]:
    return {path.relative_to(PACKAGE): ast.parse(path.read_text())
            for path in sorted(PACKAGE.rglob("*.py"))}  # fmt: skip


@cache
def all_functions() -> list[Function]:
    return [each for path, tree in trees().items() for each in functions(path, tree.body)]


@cache
def explained() -> set[str]:
    """Names of functions that tell what they take."""
    return {name for each in all_functions() if "Args:" in each.text
            for name in (each.name, each.node.name)}  # fmt: skip


@cache
def bases() -> dict[str, list[str]]:
    return {node.name: [ast.unparse(base).partition("[")[0].split(".")[-1] for base in node.bases]
            for tree in trees().values() for node in ast.walk(tree)
            if isinstance(node, ast.ClassDef)}  # fmt: skip


def ancestors(name: str) -> set[str]:
    """All classes of the package that a class inherits from."""
    above = set(bases().get(name, ()))
    return above.union(*map(ancestors, above))


def is_explained(function: Function) -> bool:
    """Whether what a function takes is told, by itself or where its docstring leads."""
    if not function.takes or "Args:" in function.text or "njit" in function.decorators:
        return True
    named = {first or second for first, second in SEE.findall(function.text)}
    if named & explained():
        return True
    # A class that it names or inherits from has the same method, or does what another one does.
    if function.owner:
        named |= ancestors(function.owner.name)
        named |= set(AS_THERE.findall(ast.get_docstring(function.owner) or ""))
    return any(f"{each}.{function.node.name}" in explained() for each in named)


def test_every_public_function_has_a_docstring():
    # What a protocol repeats of another class is told there.
    bare = [f"{each.path}:{each.name}" for each in all_functions() if not each.text
            and not (each.owner and AS_THERE.search(ast.get_docstring(each.owner) or ""))]
    assert bare == []


def test_every_public_function_tells_what_it_takes():
    assert [f"{each.path}:{each.name}" for each in all_functions() if not is_explained(each)] == []


def told_by_file(path: Path) -> set[str]:
    """Arguments of kernels that a file, or one that it names, tells of."""
    text = ast.get_docstring(trees()[path]) or ""
    told = {name for names in ENTRY.findall(text) for name in names.split(", ")}
    others = [path.with_name(f"{other}.py") for other in ELSEWHERE.findall(text)]
    return told.union(*(told_by_file(other) for other in others if other in trees()))


def test_every_kernel_or_its_file_tells_what_it_takes():
    untold = [
        f"{each.path}:{each.name}: {name}" for each in all_functions() if "njit" in each.decorators
        for name in each.takes if "Args:" not in each.text
        and name not in told_by_file(each.path) and not re.search(rf"\b{name}\b", each.text)
    ]
    assert untold == []


def test_an_args_section_names_the_functions_arguments_and_no_others():
    wrong = []
    for each in all_functions():
        section = re.search(r"^Args:\n((?: .*\n?|\n)*)", each.text + "\n", re.M)
        # Arguments of a command may stand below other titles.
        if section and each.path.parts[0] != "command_line" and "njit" not in each.decorators:
            told = {name.strip("* ") for names in re.findall(
                r"^ {4}(\*{0,2}\w+(?:, \*{0,2}\w+)*)(?: \(.*\))?:", section[1], re.M)
                for name in names.split(",")}
            wrong += [f"{each.path}:{each.name}: {told ^ set(each.takes)}"] * (
                told != set(each.takes))
    assert wrong == []
