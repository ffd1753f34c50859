"""Snapshots contain solids of all kinds of objects at their positions."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from softrobot_twin.simulation import Hold, Simulation
from softrobot_twin.study.scene_picture import (
    FREE_COLOUR,
    GUIDED_COLOUR,
    LEGEND,
    figure_of,
    take_snapshot,
)
from test.scene_changes import repeat_step

SCENES = Path(__file__).resolve().parents[2] / "config" / "scenes"


def test_a_snapshot_shows_every_body_at_its_position(stamp):
    simulation = Simulation.from_scene_file(stamp)
    simulation.model.guides.aim("press", [0.0, 0.0, -0.002])
    result = repeat_step(simulation, Hold(0.01), 4)
    shot = take_snapshot(simulation, result.contacts, "pressed")

    def height(colour):
        return [np.ptp(solid.triangles.reshape(-1, 3)[:, 2]) for solid in shot.solids
                if solid.look == "rigid" and np.array_equal(solid.colour, colour)]

    assert height(FREE_COLOUR) == pytest.approx([0.03], abs=1e-6)
    assert height(GUIDED_COLOUR) == pytest.approx([0.01])
    (mesh,) = [solid for solid in shot.solids if solid.look == "mesh"]
    assert mesh.triangles[..., 2].max() == pytest.approx(0.051 - 0.002, abs=1e-9)
    ((point, normal),) = shot.planes
    assert point @ normal == 0.0 and normal[2] == 1.0
    assert len(shot.forces[0]) == result.report.contact_count > 0


KINDS = {
    "diamond": {"fixed", "cable", "pull point", "marker", "effector"},
    "stifface": {"fixed", "cable", "pull point", "hold", "touch", "marker", "effector"},
    "springy": {"fixed", "cavity", "marker", "effector"},
    "strider": {"axis", "frame", "marker", "effector"},
    "trunk": {"cable", "pull point", "thread", "frame", "marker", "effector"},
    "cantilever": {"fixed", "cable", "pull point"},
}


@pytest.fixture(scope="module")
def shots():
    return {name: take_snapshot(Simulation.from_scene_file(SCENES / f"{name}.yaml"), None, name)
            for name in KINDS}


@pytest.fixture(scope="module")
def drawn(shots):
    """Gives the labelled picture of a scene, drawn once for each view."""
    pyplot = pytest.importorskip("matplotlib.pyplot")
    yield cache(lambda name, view=None: figure_of([shots[name]], name, view, labelled=True))
    pyplot.close("all")


# Together they have all kinds.
@pytest.mark.libraries
@pytest.mark.exhaustive
@pytest.mark.parametrize("name", ["stifface", "springy", "strider", "trunk"])
def test_the_legend_names_all_that_a_scene_has_and_nothing_else(name, drawn):
    (legend,) = drawn(name).legends
    texts = [text.get_text() for text in legend.get_texts()]
    assert texts == [text for kind, (_, _, text) in LEGEND.items() if kind in KINDS[name]]


@pytest.mark.exhaustive
@pytest.mark.parametrize(("name", "view"), [
    ("stifface", None), ("stifface", (90.0, 0.0)), ("strider", (0.0, -90.0))])
def test_no_text_of_a_labelled_picture_is_clipped_or_overlaps_another(name, view, drawn, check_texts):
    check_texts(drawn(name) if view is None else drawn(name, view))


def test_labels_name_every_thing_once_and_alike_ones_together(shots):
    told = [label.text for label in shots["diamond"].labels]
    assert {"body", "cable north", "cable east", "cable south", "cable west", "effector tip",
            "markers 0 … 7 (8)"} <= set(told)
    assert len(told) == len(set(told))
    assert "cables L0 … L3 (4)" in [label.text for label in shots["trunk"].labels]
