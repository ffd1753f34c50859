"""Each entry of a scene tells itself in words with units."""

import pytest

from softrobot_twin.scene.actuator_entries import Motor
from softrobot_twin.scene.body_entries import (
    BeamJoint,
    CrossSection,
    Fibre,
    MassSpringBody,
    Material,
    Mesh,
    Obstacle,
    RegionMaterial,
    RigidBody,
    RigidJoint,
    Spring,
    Tube,
)
from softrobot_twin.scene.entry import Entry
from softrobot_twin.scene.schema import Contact, Effector

HELIX = {"radius": 0.012, "pitch": 0.01, "reach": [0.0, 0.1]}
ENDS = [[0, 0, 0], [0, 0, 0.05]]


@pytest.mark.parametrize(("entry", "told"), [
    (Mesh(file="a.msh"), "a.msh"),
    (Mesh(file="a.stl", size=0.005, scale=0.001, rotation=[0, 0, 1.5], translation=[0.1, 0, 0]),
     "a.stl, tetrahedra of 5 mm, scale 0.001, rotation [0, 0, 1.5] rad, translation [0.1, 0, 0] m"),
    (Mesh(box={"size": [0.1, 0.02, 0.02], "cells": [4, 2, 1]}),
     "a box of [100, 20, 20] mm, 4×2×1 cells"),
    (Material(young_modulus=1e5, poisson_ratio=0.4, total_mass=0.2,
              viscosity=[{"share": 0.2, "time": 0.1}, {"share": 0.1, "time": 2.0}],
              softening={"r": 1.5, "m": 2e3}, strain_range=[-0.3, 0.5]),
     "0.2 kg in total, viscous: shares 0.2 in 0.1 s, 0.1 in 2 s, softening: r 1.5, m 2000 J/m³, β 0, "
     "strain range -30 % to 50 %"),
    (RegionMaterial(region="tip", young_modulus=1e5), ""),
    (Obstacle(name="floor", plane={}), "plane, normal [0, 0, 1]"),
    (Obstacle(name="ball", sphere={"radius": 0.01}), "sphere of radius 10 mm"),
    (Obstacle(name="bar", capsule={"radius": 0.01, "ends": ENDS}),
     "capsule of radius 10 mm, 50 mm long"),
    (Obstacle(name="bar", cylinder={"radius": 0.01, "ends": ENDS}),
     "cylinder of radius 10 mm, 50 mm long"),
    (Obstacle(name="part", surface="part.stl"), "surface part.stl"),
    (RigidBody(name="cube", mass=0.1, box={"size": [0.01, 0.02, 0.03]}),
     "free, box of [10, 20, 30] mm, 0.1 kg"),
    (RigidBody(name="palm", motion="guided", speed=0.1, turn_rate=1.0, sphere={"radius": 0.01}),
     "guided, sphere of radius 10 mm, at most 100 mm/s, at most 1 rad/s"),
    (RigidJoint(to="thigh", by="hinge", through=[0, 0, 0.1], axis=[0, 1, 0]),
     "thigh, by a hinge at [0, 0, 0.1], about [0, 1, 0]"),
    (Spring(name="s", ends=[{"point": [0, 0, 0]}, {"on": "cube", "point": [0, 0, 1]}],
            stiffness=20.0, damping=0.5), "world to cube, 20 N/m, 0.5 N s/m"),
    (Tube(name="t", points=ENDS, axial_stiffness=30.0), "2 points, EA 30 N"),
    (Fibre(name="f", stiffness=5.0, edges="wire"), "edges wire, EA 5 N in tension only"),
    (Fibre(name="f", stiffness=5.0, points=ENDS, tension_only=False),
     "2 points, EA 5 N in tension and compression"),
    (Fibre(name="f", stiffness=5.0, helix=HELIX),
     "1 of each handedness at 82.4° to the axis, radius 12 mm, EA 5 N in tension only"),
    (Fibre(name="f", stiffness=5.0, helix={**HELIX, "count": 4, "handedness": "left"}),
     "4 of left handedness at 82.4° to the axis, radius 12 mm, EA 5 N in tension only"),
    (MassSpringBody(name="m", points=[[0, 0, 0]], masses=[1.0]), "1 point, 0 springs of 1 N/m"),
    (CrossSection(rectangle={"thickness": 0.002, "width": 0.01}), "2 × 10 mm"),
    (CrossSection(tube={"radius": 0.002, "wall": 0.001}), "tube of radius 2 mm, wall 1 mm"),
    (CrossSection(constants={"area": 1e-6, "inertia_y": 1e-12, "inertia_z": 1e-12,
                             "torsion": 1e-12}), "given constants"),
    (BeamJoint(at=2, to="hub", by="hinge", axis=[0, 0, 1]), "point 2 to hub by a hinge about [0, 0, 1]"),
    (BeamJoint(at="end", to="world", by="ball"), "end to world by a ball joint"),
    (Motor(name="m", cables=["a", "b"], pulley={"radius": 0.01}),
     "shortens a, b, by a pulley of radius 10 mm"),
    (Effector(name="tip", points=ENDS), "2 points, directions x y z, weight 1"),
    (Effector(name="tip", points=ENDS, directions="x", stiffness={"target": [100.0, None, 50.0]}),
     "2 points, directions x, weight 1, stiffness x 100 N/m z 50 N/m, weight 1, "
     "a tenth of the robot's size for 100 %"),
    (Effector(name="tip", points=ENDS, directions=[], orientation={"points": ENDS * 2}),
     "2 points, orientation of 4 points, weight 1, the robot's size per radian"),
    (Contact(between=[{"pair": ["a", "b"]}], alarm_distance=0.005, contact_distance=0.001),
     "candidates below 5 mm, contact below 1 mm, tolerance 1e-08 m"),
])
def test_an_entry_tells_itself(entry, told):
    if isinstance(entry, Contact):
        told = told.replace("1e-08", f"{entry.tolerance:g}")
    assert entry.describe() == told


def all_entries(kind=Entry):
    for own in kind.__subclasses__():
        yield own
        yield from all_entries(own)


def test_what_an_entry_tells_are_keys_that_it_has():
    for kind in (kind for kind in all_entries() if not kind.__subclasses__()):
        for part in kind.told:
            for name in part.replace("}", "{").split("{")[1::2]:
                assert hasattr(kind, name.split(":")[0]) or name.split(":")[0] in kind.model_fields
