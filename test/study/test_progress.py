"""Tables."""

import io

import pytest

from softrobot_twin.harness.terminal import console, table

pytestmark = pytest.mark.libraries


@pytest.mark.parametrize("is_tty", [False, True])
def test_units_and_names_in_brackets_are_printed(monkeypatch, is_tty):
    stream = io.StringIO()
    monkeypatch.setattr(stream, "isatty", lambda: is_tty, raising=False)
    made = table("Places [mm]", "effector", "x [mm]", "median [ms]", piped=not is_tty)
    made.add_row("a [red] tip", "1", "2")
    console(stream).print(made)
    console(stream).print("my [new] robot.yaml")
    for text in ("Places [mm]", "x [mm]", "median [ms]", "a [red] tip", "my [new] robot.yaml"):
        assert text in stream.getvalue()
