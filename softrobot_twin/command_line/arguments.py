"""Parsers of commands from functions: arguments from the signature, texts from the docstring.

A parameter before ``*`` is a positional argument, one behind it an option, and required without a
default. Its annotation says how its text is read; its entry in the docstring is its help, with what
stands for the value in brackets. A section of the docstring other than `Args` is a group of options.
"""

from __future__ import annotations

import argparse
import inspect
import re
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from difflib import get_close_matches
from itertools import takewhile
from pathlib import Path
from string import Template
from textwrap import dedent, fill
from types import UnionType
from typing import Annotated, Any, NamedTuple, NoReturn, Union, get_args, get_origin, get_type_hints

from softrobot_twin.shared_files import ScenePath

TEXT_WIDTH = 78
"""Columns of the texts of a command's help."""


# Of a section of a docstring: a parameter, what stands for its value, its help.
_ENTRY = re.compile(r"(\w+)(?: \((.*?)\))?: (.*)")


class Read(NamedTuple):
    """How an argument is read, where its type does not say so; keywords of argparse."""

    type: Callable[[str], object] | None = None
    choices: tuple[str, ...] | None = None
    nargs: str | None = None
    action: str | None = None


class Explained(NamedTuple):
    """The parts of a docstring.

    Attributes:
        summary: First line.
        description: What follows, in one line.
        sections: Entries of each section by its title: their first lines, and what is below them.
    """

    summary: str
    description: str
    sections: dict[str, list[str]]


def explained(function: Callable) -> Explained:
    """The docstring of a function in its parts.

    Args:
        function: A function with a docstring in Google's style.
    """
    text, *rest = re.split(r"^(\S[^\n]*):\n(?=    )", inspect.getdoc(function) or "", flags=re.M)
    sections = {title: re.split(r"\n(?=\S)", dedent(body).strip())
                for title, body in zip(rest[::2], rest[1::2], strict=True)}
    summary, _, description = text.partition("\n")
    return Explained(summary, " ".join(description.split()), sections)


class Parser(argparse.ArgumentParser):
    """A parser that tells the nearest word it knows to a mistyped one."""

    def parse_known_args(self, args=None, namespace=None):
        """See `argparse`; a mistyped option is told before what is missing for it.

        Args:
            args: Words of the command line; None for those of the process.
            namespace: What the values are added to; None for a new one.
        """
        args = sys.argv[1:] if args is None else list(args)
        known = [flag for action in self._actions for flag in action.option_strings]
        for word in takewhile(self._is_before_others, args):
            flag = word.partition("=")[0]
            if flag.startswith("--") and not any(one.startswith(flag) for one in known):
                self.error(f"{flag} is no option here{_meant(flag, known)}")
        return super().parse_known_args(args, namespace)

    def _is_before_others(self, word: str) -> bool:
        """Whether a word is before arguments that are no options, or are those of a command."""
        return word != "--" and (self._subparsers is None or word.startswith("-"))

    def error(self, message: str) -> NoReturn:
        """See `argparse`.

        Args:
            message: What is wrong.
        """
        if found := re.search(r"invalid choice: '(.*?)' \(choose from (.*)\)", message):
            message += _meant(found[1], re.findall(r"[\w-]+", found[2]))
        super().error(message)


def _meant(word: str, known: Iterable[str]) -> str:
    """A hint at the word that is most like a mistyped one; empty where none is."""
    found = get_close_matches(word, known, n=1)
    return f"; is {found[0]} meant?" if found else ""


def add_command(
    commands, function: Callable[..., int], exclusive: Sequence[str], is_one_needed: bool,
    constants: Mapping[str, object], foot: str,
) -> None:  # fmt: skip
    """Declares a command.

    Args:
        commands: Subparsers of the program.
        function: Runs the command with its arguments and returns the exit code.
        exclusive: Options of which at most one may be given.
        is_one_needed: Whether one of them must be given.
        constants: Values of the words with ``$`` in the texts.
        foot: Text below the examples.
    """
    name, told = function.__name__.replace("_", "-"), explained(function)
    examples = tuple(example.removeprefix(f"softrobot_twin {name}").lstrip(" ")
                     for example in told.sections.pop("Examples", ()))
    # argparse fills a text of one paragraph or none at all; here the examples keep their lines.
    shown = "\n".join(f"  %(prog)s {example.replace('%', '%%')}" for example in examples)
    parser = commands.add_parser(
        name, help=_phrase(told.summary), description=fill(told.description, TEXT_WIDTH),
        epilog=f"examples:\n{shown}\n\n{foot}",
        formatter_class=argparse.RawDescriptionHelpFormatter)
    texts, groups = {}, {"Args": parser}
    for title, entries in told.sections.items():
        if title not in groups:
            groups[title] = parser.add_argument_group(_phrase(title))
        for entry in entries:
            if found := _ENTRY.fullmatch(" ".join(entry.split())):
                own, metavar, text = found.groups()
                texts[own] = groups[title], metavar, text
    if exclusive:
        group = parser.add_mutually_exclusive_group(required=is_one_needed)
        groups |= dict.fromkeys(exclusive, group)
    parameters = inspect.signature(function).parameters
    hints = get_type_hints(function, include_extras=True)
    for own, parameter in parameters.items():
        group, metavar, text = texts[own]
        words = Template(text).safe_substitute(constants, default=parameter.default)
        _add_argument(groups.get(own, group), parameter, hints[own], metavar,
                      _phrase(words).replace("%", "%%"))
    files = [own for own, one in parameters.items() if one.kind is not one.KEYWORD_ONLY
             and own in ("scene", "scenes")]  # fmt: skip
    if files:
        parser.add_argument("--set", dest="changes", nargs="+", action="extend", default=[],
                            metavar="KEY=VALUE", help=_CHANGES)
    parser.set_defaults(run=lambda chosen: function(**_values(chosen, parameters, files)), examples=examples)


_CHANGES = ("other values of entries of the scene, such as body.material.young_modulus=1.5e5, "
            "cables.north.rate=0.1 or cables[0].tension=[0,5]")


def _values(chosen: argparse.Namespace, names: Iterable[str], files: Sequence[str]) -> dict[str, Any]:
    """The values of a function's parameters; paths of scene files carry what `--set` gives."""
    values = {own: getattr(chosen, own) for own in names}
    if files and chosen.changes:
        for own in files:
            given = values[own]
            values[own] = (ScenePath(given, chosen.changes) if isinstance(given, Path)
                           else [ScenePath(path, chosen.changes) for path in given])
    return values


def _add_argument(group, parameter: inspect.Parameter, hint, metavar: str | None, text: str) -> None:
    """Declares an argument by its parameter.

    Args:
        group: Parser, or group of options, that it is added to.
        parameter: Its place and its default.
        hint: Its annotation: a type, a tuple of numbers, a sequence, perhaps annotated by `Read`.
        metavar: What stands for its value in the help.
        text: Its help.
    """
    is_option = parameter.kind is parameter.KEYWORD_ONLY
    given: dict[str, Any] = {"help": text}
    if metavar is not None:
        given["metavar"] = tuple(metavar.split()) if " " in metavar else metavar
    if parameter.default is not parameter.empty:  # An option that is given again adds to a list.
        given["default"] = list(parameter.default) if parameter.default == () else parameter.default
    name = parameter.name.rstrip("_")
    if not is_option:
        flag = parameter.name
    else:
        flag = f"--{'no-' if parameter.default is True else ''}{name.replace('_', '-')}"
        given["dest"] = parameter.name
        if parameter.default is parameter.empty:
            given["required"] = True
    given |= _read_by(hint, is_option)
    if hint is bool:
        given["action"] = "store_false" if parameter.default else "store_true"
        del given["default"]
    group.add_argument(flag, **given)


def _read_by(hint, is_option: bool) -> dict[str, Any]:
    """Keywords of argparse that read a value of a type."""
    if get_origin(hint) is Annotated:
        kind, own = get_args(hint)
        found = _read_by(kind, is_option)
        return found | {word: value for word, value in own._asdict().items() if value is not None}
    if get_origin(hint) in (Union, UnionType):
        return _read_by(get_args(hint)[0], is_option)
    if get_origin(hint) is tuple:
        return {"nargs": len(get_args(hint)), **_read_by(get_args(hint)[0], is_option)}
    if get_origin(hint) is Sequence:
        own = {"nargs": "+", "action": "extend"} if is_option else {"nargs": "*"}
        return own | _read_by(get_args(hint)[0], is_option)
    return {"type": hint} if hint in (float, Path) else {}


def _phrase(text: str) -> str:
    """A sentence as argparse shows it: without a capital at its beginning and a full stop."""
    text = text.removesuffix(".")
    return text if text[1:2].isupper() else text[:1].lower() + text[1:]
