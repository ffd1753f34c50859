"""What cannot be simulated is refused by the entry that is wrong: one table for all entries.

What needs a body or a file of its own to be wrong is refused in the file of that subject.
"""

import pytest

from softrobot_twin.errors import SceneError
from softrobot_twin.scene.material_presets import UNFITTED
from test.scene_changes import LEFT_OUT, changed

TIP, NAN = [0.01, 0.01, 0.1], float("nan")
ALL, FAR = ({"minimum": [low] * 3, "maximum": [high] * 3} for low, high in ((-1, 1), (5, 6)))
BOX = {"name": "box", "box": {"size": [0.02, 0.03, 0.04]}, "mass": 0.1}
BEHIND_A_ROD = {
    "obstacles": [{"name": "rod", "cylinder": {"ends": [[0.03, -0.05, 0.08], [0.03, 0.07, 0.08]],
                                               "radius": 0.005}}],
    "contact": {"between": [{"pair": ["beam", "rod"]}]},
}  # fmt: skip
RUBBER = {"law": "neo_hookean", "young_modulus": 2e5, "poisson_ratio": 0.45, "density": 1000.0}
VISCOSITY, SOFTENING = [{"share": 0.1, "time": 1.0}], {"r": 1.5, "m": 30.0, "beta": 0.1}
VERTEBRAE = {"rigid": [
    {"name": name, "box": {"minimum": [-1, -1, low], "maximum": [1, 1, low + 0.02]}}
    for name, low in (("foot", -0.001), ("head", 0.081))
]}  # fmt: skip
ON_A_CART = {
    "body.fixed": LEFT_OUT, "body.attached": [{"to": "cart", "box": {
        "minimum": [-1, -1, -1e-6], "maximum": [1, 1, 1e-6]}}],
    "rigid_bodies": [{"name": "cart", "motion": "guided", "box": {"size": [0.04, 0.04, 0.01]},
                      "position": [0.01, 0.01, -0.005]}],
    "slides": [{"name": "lift", "body": "cart", "axis": [0, 0, 1], "travel": [-0.01, 0.03]}],
    "cables.*.pull_point_on": "cart",
}  # fmt: skip


def strip(name="leg", points=((0.0, 0.0, 0.0), (0.0, 0.0, -0.2)), **entries) -> dict:
    """A clamped strip of silicone."""
    return {
        "name": name, "points": [list(point) for point in points], "elements": 4, "fixed": ["start"],
        "section": {"rectangle": {"thickness": 0.005, "width": 0.01}},
        "thickness_direction": [1.0, 0.0, 0.013],
        "material": {"young_modulus": 35e6, "poisson_ratio": 0.45, "density": 1220.0}, **entries,
    }  # fmt: skip


HINGE = {"at": "start", "to": "world", "by": "hinge", "axis": [0, 1, 0]}
HINGED = {
    "beams": [strip(fixed=[], joined=[HINGE])],
    "hinge_motors": [{"name": "m", "beam": "leg", "at": "start", "angle": [-2.9, 2.9]}],
}  # fmt: skip
JOINT, MOTOR, PRESET = "beams.0.joined.0.", "hinge_motors.0.", "body.material.preset"
CLAMPED = {"beams": [strip()], "rigid_bodies": [
    {"name": "weight", "motion": "guided", "position": [0, 0, -0.2], "sphere": {"radius": 0.01}}]}
HALF_OPEN = {"time_scheme": "generalized_alpha", "integration": "dynamic"}

# Of each scene: entries that are changed, and what the error must say: its entry, and why.
REFUSED = {
    "beam": [
        # Fixed nodes and floating bodies.
        ({"body.fixed": LEFT_OUT}, "body.fixed", "not held"),
        ({"body.fixed": [{"box": ALL}]}, "body.fixed", "nothing in the scene can move"),
        # Cables, their pulleys, stretch and friction.
        ({"cables.0.points": [[0, 0, 0], [0.01, 0.01, 0]]}, "cables[0]", "moves nothing"),
        *(({f"cables.0.pulley.{key}": value, "cables.0.pulley.radius": radius},
           f"cables[0].pulley{place}", why) for key, value, radius, place, why in (
              ("winds", "positive", 0.0, ".radius", " m"),
              ("winds", "positive", float("inf"), ".radius", "inf"),
              ("angle", [0.1, 0.5], 0.01, ".angle", "0, must lie within"),
              ("angle", [0.5, -0.5], 0.01, ".angle", "lower limit"),
              ("rate", -1.0, 0.01, ".rate", "rad/s"), ("winds", "left", 0.01, ".winds", "left"),
              ("diameter", 0.1, 0.01, "", "diameter"))),
        ({"cables.2.pulley": {"radius": 0.01}, "motors": [
            {"name": "m", "cables": ["west", "south"], "pulley": {"radius": 0.01}}]},
         "motors[0].pulley", "cables[2].pulley"),
        ({"cables.1.shortening": [0.02, 0.0]}, "cables[1].shortening", "lower limit"),
        ({"cables.1.tension": [40.0, 0.0]}, "cables[1].tension", "lower limit"),
        *(({"cables.0.axial_stiffness": value}, "cables[0].axial_stiffness", " N")
          for value in (0.0, -3.0, NAN)),
        ({"cables.0.friction": -0.1}, "cables[0].friction", "-0.1"),
        ({"cables.0.friction": NAN}, "cables[0].friction", "nan"),
        ({"cables.0.friction": 0.3, "cables.0.presliding": 0.0}, "cables[0].presliding", " m"),
        ({"cables.0.friction": 0.0, "cables.0.presliding": 1e-4}, "cables[0].presliding",
         "give friction"),
        ({"cables.*.friction": 0.3, **HALF_OPEN},
         "cables[0].friction", "time_scheme generalized_alpha"),
        ({"cables.*.friction": 0.3, "integration": "dynamic", "time_scheme": "generalized_alpha"},
         "cables[0].friction", "time_scheme generalized_alpha"),
        # Contact, obstacles and their files.
        *(({**BEHIND_A_ROD, "contact.force_limit": value}, "force_limit", str(value))
          for value in (0.0, -1.0, NAN)),
        ({"body.contact_surface": {"file": "nowhere.stl"}, **BEHIND_A_ROD},
         "body.contact_surface.file", "no such file"),
        *(({"obstacles": [{"name": "one", **shape}], "contact": {
            "between": [{"pair": ["beam", "one"]}]}}, "obstacles[0]", why) for shape, why in (
              ({}, "exactly one of"), ({"sphere": {"radius": 0.0}}, "radius"),
              ({"sphere": {"radius": 0.1}, "plane": {}}, "exactly one of"),
              ({"capsule": {"ends": [[0, 0, 0], [0, 0, 0]], "radius": 0.1}}, "capsule"),
              ({"plane": {"normal": [0, 0, 0]}}, "plane"), ({"plane": {}, "mass": 1.0}, "mass"))),
        ({"obstacles": [{"name": "one", "plane": {}}, {"name": "two", "sphere": {"radius": 0.1}}],
          "contact": {"between": [{"pair": ["one", "two"]}]}}, "between[0]", "one"),
        # Effectors: directions, orientations and stiffnesses.
        ({"effectors.0.directions": []}, "effectors[0]", "directions"),
        ({"effectors.0.orientation": {"points": [[0.002, 0.002, 0.1], [0.018, 0.018, 0.1]]}},
         "orientation.points", "do not lie on one line"),
        ({"effectors.0.orientation": {"points": []}}, "effectors[0].points",
         "do not lie on one line"),
        ({"effectors.0.orientation": {"pointing": [0.0, 0.0, 0.0]}}, "pointing",
         "must not be zero"),
        *(({"effectors.0.stiffness": entry}, f"stiffness.{key}", "")
          for key, entry in (("target", {"target": [None, None, -300.0]}),
                             ("weight", {"weight": -1.0}), ("length", {"length": 0.0}),
                             ("target", {"target": [300.0]}))),
        # Touches.
        *(({"touches": [{"name": "finger", "points": [TIP], **entry}]}, place, "")
          for entry, place in (({"body": "nothing"}, "touches[0].body"),
                               ({"directions": []}, "directions"),
                               ({"force_limit": -1.0}, "force_limit"),
                               ({"points": [[0.1, 0.1, 0.1]]}, "touches[0].points"))),
        ({"touches": 2 * [{"name": "finger", "points": [TIP]}]}, "touches",
         "given more than once"),
        # Slides.
        *(({**ON_A_CART, "slides.0.travel": travel}, "slides[0].travel", "")
          for travel in ([0.01, -0.01], [0.01, 0.02])),
        *(({**ON_A_CART, "body.damping": {"mass": 10.0}, "integration": integration}, "lift",
           "quasi_static") for integration in ("first_order", "dynamic")),
        ({**ON_A_CART, "body.fixed": [{"box": {"minimum": [-1, -1, 0.099], "maximum": [1, 1, 1]}}]},
         "lift", "fixed"),
        ({**ON_A_CART, "cables.1.pull_point_on": "world"}, "lift", "north"),
        ({**ON_A_CART, "springs": [{"name": "tether", "stiffness": 10.0, "ends": [
            {"on": "beam", "point": TIP}, {"point": [0.01, 0.01, 0.2]}]}]}, "lift", "tether"),
        # Masses.
        *(({"body.material": {"young_modulus": 1e5, "poisson_ratio": 0.0, **weight}},
           "body.material", word) for weight, words in (
              ({"total_mass": 0.5, "density": 1070.0}, ("density", "total_mass", "both")),
              ({}, ("density", "total_mass", "required")),
              ({"total_mass": 0.0}, ("total_mass", "kg")),
              ({"total_mass": float("inf")}, ("total_mass", "kg"))) for word in words),
        # Laws, incompressible rubber, and rubber that remembers.
        ({"body.volume": "patches", "body.material.law": "linear"}, "body.volume = 'patches'",
         "linear"),
        ({"body.material.law": "corotational", "body.material.poisson_ratio": 0.5},
         "body.material.poisson_ratio = 0.5", ""),
        ({"body.volume": "patches", "body.material": RUBBER, "body.vertebrae": VERTEBRAE},
         "body.volume", "vertebrae"),
        ({"body.element": "smoothed", "body.material.poisson_ratio": 0.45,
          "body.reduced": {"file": "none.npz"}}, "body.volume", "name volume: per_element"),
        *(({"body.material": {**RUBBER, **memory}, "body.vertebrae": VERTEBRAE},
           f"material.{key}", "not built for bodies with vertebrae") for key, memory in (
              ("viscosity", {"viscosity": VISCOSITY}), ("softening", {"softening": SOFTENING}))),
        *(({"body.material": {**RUBBER, **changes}, **scene}, key, why)
          for changes, scene, key, why in (
              ({"law": "corotational", "viscosity": VISCOSITY}, {}, "body.material.viscosity",
               "corotational"),
              ({"law": "linear", "softening": SOFTENING}, {}, "body.material.softening", "linear"),
              ({"viscosity": [{"share": 0.6, "time": 1.0}, {"share": 0.4, "time": 2.0}]}, {},
               "body.material.viscosity", "less than 1"),
              ({"viscosity": [{"share": 0.6, "time": -1.0}]}, {},
               "body.material.viscosity[0].time", " s"),
              ({"softening": {"r": 0.5, "m": 10.0}}, {}, "body.material.softening.r", "above 1"),
              ({"viscosity": VISCOSITY}, HALF_OPEN, "time_scheme", "viscous"))),
        # Materials by name.
        *(({"body.material": {"preset": name}}, PRESET, "no published tensile curve")
          for name in UNFITTED),
        *(({"body.material": entry}, PRESET, why) for entry, why in (
            ({"preset": "ecoflex"}, "is ecoflex_00_30 or ecoflex_00_50 meant?"),
            ({"preset": "Dragon Skin 10"}, "is dragon_skin_10 meant?"),
            ("ecoflex", "is ecoflex_00_30 or ecoflex_00_50 meant?"),
            ({"preset": "dragonskin"}, "dragon_skin_30"))),
        *(({"body.material": {"preset": "tpu_85a", key: value}}, f"body.material.{key}", why)
          for key, value, why in (
              ("law", "corotational", "tpu_85a"), ("young_modulus", 1e6, "tpu_85a"),
              ("constants", {"c10": 1.0, "c01": 2.0}, "tpu_85a"),
              ("strain_range", [0.1, 0.5], "between -1 and 0"))),
        # Motion.
        ({"integration": "first_order"}, "body.damping.mass", ""),
        *(({"integration": "dynamic", **scheme, **entry}, key, "")
          for key, scheme, entry in (
              ("time_scheme", {"integration": "quasi_static"}, {"time_scheme": "generalized_alpha"}),
              ("integration", {"time_scheme": "generalized_alpha"}, {"integration": "first_order"}),
              ("spectral_radius needs time_scheme", {}, {"spectral_radius": 0.5}),
              *(("spectral_radius =", HALF_OPEN, {"spectral_radius": radius})
                for radius in (1.2, -0.1, NAN)),
              ("time_scheme", {}, {"time_scheme": "leapfrog"}))),
    ],
    "diamond": [
        ({"body.fixed": [{"nodes": [0, 1]}]}, "body.fixed =", "not held"),
        ({"body.fixed": [{"box": FAR}]}, "body.fixed[0] =", "holds no node"),
        ({"body.fixed": [{"nodes": [0, 1, 10**6]}]}, "body.fixed[0].nodes =", "nodes 0 to"),
        ({"cables.1.points": [[-0.15, 0.0, 0.045]]}, "cables[1].points[0] =", "mm outside the body"),
        ({"effectors.0.points": [[-0.15, 0.0, 0.045]]}, "effectors[0].points[0] =",
         "several points count by their mean"),
    ],
    "inflatable": [
        *(({f"cavities.0.{key}": value for key, value in entries.items()}, f"cavities[0]{place}", why)
          for entries, place, why in (
              ({"pressure": [1.0, 5.0]}, ".pressure", "at rest, 0, must lie within"),
              ({"pressure": [5.0, 1.0]}, ".pressure", "lower limit is above"),
              ({"growth": [1e-6, 2e-6]}, ".growth", "at rest, 0, must lie within"),
              ({"volume": [5e-6, 6e-6]}, ".volume", "at rest, 4e-06 m³, must lie"),
              ({"volume": [-1.0, 6e-6]}, ".volume", "is not negative"),
              ({"control": "flow"}, ".control", "flow"), ({"walls": []}, ".walls", ""),
              ({"walls": [{}]}, ".walls[0]", "either a part"),
              ({"walls": [{"part": "gas"}]}, ".walls[0].part", ""),
              ({"walls": [{"file": "no.stl"}]}, ".walls[0].file", "no such file"),
              ({"walls": [{"file": "no.stl", "body": "hollo"}]}, "", "is hollow meant"),
              ({"rate": -1.0}, ".rate", ""), ({"flow": 0.0}, ".flow", ""),
              ({"flow": 1e-6, "control": "volume"}, ".flow", "give its greatest change"),
              ({"presure": [0.0, 1.0]}, ".presure", "is pressure meant"))),
        ({"cavities.0.name": "down", "cables": [
            {"name": "down", "pull_point": [0.0, 0.0, 0.0], "points": [[0.0, 0.0, 0.06]]}]},
         "cable, cavity", "down is given more than once"),
        ({"body.fixed": [{"box": {"minimum": [-1, -1, -1], "maximum": [1, 1, 0.051]}}]}, "cavities[0]",
         "lie wholly in what is fixed"),
        *(({"cavities": [], "sealed_cavities": [{"name": "air", "walls": [{"part": "gas"}], **entry}]},
           f"sealed_cavities[0].{place}", why) for entry, place, why in (
              ({"pressure": -2e5}, "pressure", "above zero"), ({}, "walls[0].part", ""))),
    ],
    "unheld": [
        ({"rigid_bodies": [BOX]}, "rigid_bodies[0].motion", "box floats"),
        ({"rigid_bodies": [BOX], "integration": "first_order"}, "first_order", ""),
        ({"rigid_bodies": [{"name": "box", "mass": 0.1, "surface": {"file": "nowhere.stl"}}],
          "integration": "dynamic"}, "rigid_bodies[0].surface.file", "no such file"),
        *(({"rigid_bodies": [BOX], "integration": "dynamic", **contact, "obstacles": [
            {"name": "wall", "plane": {"normal": [1, 0, 0], "point": [-1, 0, 0]}},
            {"name": "floor", "surface": {"file": "nowhere.stl"}}]},
           "obstacles[1].surface.file = 'nowhere.stl'", "there is no such file")
          for contact in ({}, {"contact": {"between": [{"pair": ["box", "floor"]}]}})),
        ({"mass_springs": [{"name": "net", "points": [[0, 0, 0], [0.1, 0, 0], [0.2, 0, 0]],
                            "masses": [0.1], "springs": [[0, 1]], "fixed": [0]}]},
         "mass_springs[0]", "floats"),
    ],
    "clamped": [
        *(({f"beams.0.{key}": value}, "beams[0]", why) for key, value, why in (
            ("fixed", [], "floats"), ("elements", 0, "elements"),
            ("points", [[0, 0, 0], [0, 0, 0]], "the same point"),
            ("points", [[0, 0, 0], [1, 0, NAN]], "points"),
            ("section", {"tube": {"radius": 0.01, "wall": 0.02}}, "wall of a tube"),
            ("section", {}, "exactly one of rectangle"),
            ("thickness_direction", LEFT_OUT, "thickness_direction"),
            ("thickness_direction", [0, 0, 1], "lies along the axis"),
            ("joined", [{"at": "end", "to": "nobody"}], "nobody"),
            ("joined", [{"at": 7, "to": "weight"}], "joins point 7"),
            ("joined", [{"at": "start", "to": "weight"}], "cannot be fixed too"),
            ("material.young_modulus", -1.0, "young_modulus"))),
        ({"beams": [strip(), strip("b", [[0, 0, -0.4], [0, 0, -0.3]], fixed=[],
                                   joined=[{"at": "end", "to": "leg"}])]}, "beams[1]", "0.1 m away"),
    ],
    "hinged": [
        ({JOINT + "axis": LEFT_OUT}, "joined", "needs an axis"),
        ({JOINT + "axis": [0, 0, 0]}, "joined", "needs an axis"),
        ({JOINT + "by": "ball"}, "joined", "axis is that of a hinge"),
        ({"beams.0.joined": [{"at": "start", "to": "world"}]}, "joined", "given as fixed"),
        ({"beams.0.fixed": ["start"]}, "beams[0].joined[0]", "alone carries"),
        ({"beams.0.joined": [HINGE, {**HINGE, "axis": [1, 0, 0]}]}, "beams[0].joined[1]",
         "alone carries"),
        ({JOINT + "to": "wrld"}, "beams[0].joined[0].to", "wrld"),
        ({MOTOR + "at": "end"}, "hinge_motors[0].at", "is not on a hinge"),
        ({MOTOR + "at": 7}, "hinge_motors[0].at", "points 0 to 1"),
        ({MOTOR + "beam": "log"}, "hinge_motors[0].beam", "log"),
        ({"hinge_motors": [{**HINGED["hinge_motors"][0], "name": name} for name in "mn"]},
         "hinge_motors[1].at", "already"),
        ({MOTOR + "angle": [0.1, 1.0]}, "angle", "at rest, 0"),
        ({MOTOR + "angle": [-3.1, 3.1]}, "angle", "at most 6 rad"),
        ({MOTOR + "torque": [1.0, 2.0]}, "torque", "0, must lie"),
        ({"beams": [*HINGED["beams"], strip("b", [[0, 0, 0], [0.1, 0, 0]], fixed=[], joined=[
            {**HINGE, "to": "leg"}], thickness_direction=[0, 0, 1])]}, "beams[1]",
         "is on a hinge itself"),
        ({JOINT + "by": "ball", JOINT + "axis": LEFT_OUT}, "hinge_motors[0].at",
         "ball joint, which has no axis"),
    ],
}  # fmt: skip


@pytest.fixture
def make(request, simulate):
    """Makes one of the scenes by its name, changed."""

    def of_entries(entries):
        def made(*changes):
            mapping = {}
            changed(entries, *changes)(mapping)
            return simulate(**mapping)

        return made

    own = {"unheld": {}, "clamped": CLAMPED, "hinged": HINGED}
    return lambda scene, change: (
        of_entries(own[scene]) if scene in own else request.getfixturevalue(scene)
    )(change)


@pytest.mark.parametrize(
    "scene, change, entry, why", [(scene, *row) for scene, rows in REFUSED.items() for row in rows]
)
def test_an_entry_that_cannot_be_used_is_refused_by_name(make, scene, change, entry, why):
    with pytest.raises(SceneError) as refused:
        make(scene, change)
    assert entry in str(refused.value) and why in str(refused.value)


def test_the_scenes_are_sound_without_these_changes(make):
    for scene in REFUSED:
        if scene != "unheld":
            assert make(scene, None).state.step_count == 0
    for change in (BEHIND_A_ROD, ON_A_CART, {"body.material": RUBBER},
                   {"body.material": {"preset": "tpu_85a"}}):  # fmt: skip
        make("beam", change)
