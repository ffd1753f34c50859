"""Names from files and networks are shown as they are, and move no cursor."""

import pytest

from softrobot_twin.errors import MOST_SHOWN, printable, printable_lines


@pytest.mark.parametrize(("text", "shown"), (
    ("north.shortening_max = 0.04 m³, ν 0.45 …", None), ("", None),
    ("liar\n[ERROR] [twin]: burns", r"liar\n[ERROR] [twin]: burns"),
    ("\x1b[31mred\x1b[0m\r", r"\x1b[31mred\x1b[0m\r"),
    ("a\0b\x85c\u2028d", r"a\x00b\x85c\u2028d"), ("\u202eevil", r"\u202eevil"),
    ("\ud800\udcff", r"\ud800\udcff"),
))  # fmt: skip
def test_what_moves_a_cursor_or_has_no_encoding_is_escaped(text, shown):
    assert printable(text) == (text if shown is None else shown)
    assert printable(text).isprintable() and printable(text).encode().decode() == printable(text)


def test_a_very_long_text_is_cut_off():
    assert len(printable("x" * 10**6)) == MOST_SHOWN + 1


def test_lines_that_are_meant_stay_lines():
    assert printable_lines("one\n two\x1b[31m\nthree") == "one\n two\\x1b[31m\nthree"
