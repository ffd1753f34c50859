"""Fixtures that give a function to call."""

import inspect
from collections.abc import Callable
from functools import partial

import pytest


def builder(function: Callable | None = None, **options):
    """A fixture that gives this function, to be called with its parameters after the slash.

    Those before the slash are fixtures, and filled in: a test that asks for `bar`, which is
    `def bar(simulate, /, length)`, calls `bar(0.1)`.

    Args:
        function: The function.
        options: Of `pytest.fixture`.
    """
    if function is None:
        return partial(builder, **options)
    filled = [parameter.replace(kind=inspect.Parameter.POSITIONAL_OR_KEYWORD)
              for parameter in inspect.signature(function).parameters.values()
              if parameter.kind is inspect.Parameter.POSITIONAL_ONLY]  # fmt: skip

    def give(**fixtures):
        return partial(function, *fixtures.values()) if fixtures else function

    give.__name__, give.__doc__, give.__module__ = (
        function.__name__, function.__doc__, function.__module__
    )  # fmt: skip
    give.__signature__ = inspect.Signature(filled)
    return pytest.fixture(**options)(give)


def each_of(values, **options):
    """A fixture that gives each of these values in turn; `options` are those of `pytest.fixture`."""
    return pytest.fixture(params=values, **options)(lambda request: request.param)


def at_rest(name: str):
    """A fixture that gives what a fixture of this name gives, reset."""
    def give(request):
        found = request.getfixturevalue(name)
        found.reset()
        return found

    return pytest.fixture(give)
