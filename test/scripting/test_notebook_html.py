"""What a notebook shows of robots, results, matrices and tables of runs."""

import sys
from xml.etree import ElementTree

import numpy as np
import pytest

import softrobot_twin as st
from softrobot_twin.scripting.notebook_html import effectors_html, table_html, text_html
from softrobot_twin.view import ViewError


class Page:
    """The tables and texts of a page; every tag must be closed in order."""

    def __init__(self, html):
        root = ElementTree.fromstring(f"<page>{html}</page>")
        self.tables = [[["".join(cell.itertext()) for cell in row] for row in table.iter("tr")]
                       for table in root.iter("table")]
        self.texts = [each.text for each in root if each.tag != "table"]


def test_texts_are_escaped():
    wicked = "<script>alert('&')</script>"
    html = text_html(wicked) + table_html([wicked], [[wicked]]) + effectors_html([wicked], np.zeros((1, 3)))
    assert "<script" not in html
    page = Page(html)
    assert page.texts == [wicked]
    assert page.tables[0] == [[wicked], [wicked]] and page.tables[1][1][0] == wicked


def test_a_table_of_a_run_without_pandas_is_shown_as_a_table(finger, monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    table = finger.run(st.hold(), steps=30)
    assert isinstance(table, np.ndarray)
    shown = Page(table._repr_html_())
    assert shown.tables[0][0] == list(table.dtype.names)
    assert len(shown.tables[0]) == 22 and shown.texts == ["30 rows"]
    assert float(shown.tables[0][-1][1]) == pytest.approx(table["time_s"][-1])
    assert table["time_s"]._repr_html_() is None


def test_a_view_in_a_notebook_without_its_package_names_what_to_install(finger, monkeypatch):
    rerun = pytest.importorskip("rerun")
    monkeypatch.setattr("softrobot_twin.view.recording.find_spec", lambda name: None)
    with pytest.raises(ViewError, match=f"pip install rerun-notebook=={rerun.__version__}"):
        finger.view(notebook=True)


def test_a_view_in_a_notebook_gets_every_step_and_is_displayed(finger, monkeypatch):
    """A stand-in takes the bytes that rerun sends, as the viewer of rerun-notebook does."""
    rerun = pytest.importorskip("rerun")
    notebook = pytest.importorskip("rerun.notebook")
    sent, displayed = [], []

    class Viewer:
        def __init__(self, *, recording, blueprint):
            rerun.bindings.set_callback_sink(recording=recording.to_native(), callback=sent.append)
            recording.send_blueprint(blueprint)

        def display(self):
            displayed.append(self)

    monkeypatch.setattr("softrobot_twin.view.recording.find_spec", lambda name: name)
    monkeypatch.setattr(notebook, "Viewer", Viewer)
    with finger.view(notebook=True) as view:
        assert view.address is None and "in a notebook" in repr(view)
        finger.run(st.hold(), steps=3)
        view._ipython_display_()
    assert view.shown_count == 4 and view.failure is None and len(displayed) == 1
    assert sum(map(len, sent)) > 10_000 and sent[0].startswith(b"RRF2")
