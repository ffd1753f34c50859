"""Views of robots in notebooks."""

import pytest

import softrobot_twin as st
from softrobot_twin.view import ViewError


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
