"""What a notebook shows of robots, results, matrices and tables of runs."""

import base64
import pickle
import sys
from html.parser import HTMLParser

import numpy as np
import pytest

import softrobot_twin as st
from softrobot_twin.scripting.notebook_html import (
    Actuator,
    actuators_html,
    effectors_html,
    table_html,
    text_html,
)
from softrobot_twin.simulation.building.actuator_kinds import Quantity
from softrobot_twin.view import ViewError


class Page(HTMLParser):
    """The tables, texts and images of a page; every tag must be closed in order."""

    def __init__(self, html):
        super().__init__()
        self.tables, self.texts, self.images, self._open = [], [], [], []
        self.feed(html)
        self.close()
        assert not self._open

    def handle_starttag(self, tag, attrs):
        if tag == "img":
            self.images.append(dict(attrs))
            return
        self._open.append(tag)
        if tag == "table":
            self.tables.append([])
        elif tag == "tr":
            self.tables[-1].append([])
        elif tag in ("th", "td"):
            self.tables[-1][-1].append("")
        else:
            self.texts.append("")

    def handle_endtag(self, tag):
        assert self._open.pop() == tag

    def handle_data(self, data):
        if self._open[-1] in ("th", "td"):
            self.tables[-1][-1][-1] += data
        else:
            self.texts[-1] += data


def column(table, name):
    """A column of a table as numbers, by its header."""
    place = table[0].index(name)
    return np.array([float(row[place]) for row in table[1:]])


def test_a_robot_shows_its_name_parts_actuators_effectors_and_picture(finger):
    pytest.importorskip("matplotlib")
    finger.step(st.setpoints(upper_shortening_m=0.001, lower_shortening_m=0.0))
    page = Page(finger._repr_html_())
    assert page.texts[0] == "finger" and "144 tetrahedra" in page.texts[1]
    effectors, cables = page.tables
    assert cables[0] == ["cable", "length [mm]", "shortening [mm]", "tension [N]"]
    assert [row[0] for row in cables[1:]] == list(finger.actuator_names)
    state = finger.state
    assert column(cables, "length [mm]") == pytest.approx(1e3 * state.setpoints, rel=1e-3)
    assert column(cables, "shortening [mm]")[0] == pytest.approx(1.0, rel=1e-3)
    assert column(cables, "tension [N]") == pytest.approx(state.efforts, rel=1e-3)
    assert effectors[1][0] == "tip"
    assert [float(cell) for cell in effectors[1][1:]] == pytest.approx(
        1e3 * finger.effectors["tip"], rel=1e-3)
    (image,) = page.images
    kind, _, data = image["src"].partition(",")
    assert kind == "data:image/png;base64" and image["alt"].startswith("finger at 0.02 s")
    assert base64.b64decode(data).startswith(b"\x89PNG")


def test_a_result_shows_status_limits_errors_and_actuators(finger):
    result = finger.step(st.targets(tip=[0.1, 0.01, 0.03]))
    page = Page(pickle.loads(pickle.dumps(result))._repr_html_())
    assert result.status.value in page.texts[0] and result.active_limits[0] in page.texts[0]
    effectors, cables = page.tables
    assert column(effectors, "from its target [mm]")[0] == pytest.approx(
        1e3 * result.errors["tip"], rel=1e-3)
    assert column(cables, "tension [N]")[0] == pytest.approx(
        result["upper_tension_N"], rel=1e-3, abs=1e-9)


def test_a_matrix_shows_its_meaning_and_names(finger):
    matrix = finger.jacobian("tip")
    page = Page(matrix._repr_html_())
    assert page.texts == [matrix.meaning]
    assert page.tables[0][0] == ["", *matrix.columns]
    assert column(page.tables[0], matrix.columns[1]) == pytest.approx(
        matrix[matrix.columns[1]], rel=1e-3)


def test_each_kind_of_actuator_has_a_table_with_its_units():
    pressure, volume = Quantity("pressure", "Pa"), Quantity("volume_change", "m3")
    angle, torque = Quantity("angle", "rad"), Quantity("torque", "Nm")
    html = actuators_html(
        [Actuator("left", "cavity", (pressure, volume, pressure)),
         Actuator("knee", "motor", (angle, angle, torque))],
        np.array([2.0e3, np.pi / 6]), np.array([1.5e-6, np.pi / 6]), np.array([2.0e3, 0.25]),
    )
    assert Page(html).tables == [
        [["cavity", "pressure [kPa]", "volume_change [cm³]"], ["left", "2", "1.5"]],
        [["motor", "angle [°]", "torque [N m]"], ["knee", "30", "0.25"]],
    ]


def test_texts_are_escaped():
    wicked = "<script>alert('&')</script>"
    html = text_html(wicked) + table_html([wicked], [[wicked]]) + effectors_html(
        [wicked], np.zeros((1, 3)))
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
