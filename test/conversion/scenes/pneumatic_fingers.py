"""Two fingers with a chamber, turned; a cube on a floor; contact with friction."""

import Sofa
from loaded import add_loaded


class Squeeze(Sofa.Core.Controller):
    def onAnimateBeginEvent(self, event):
        pass


def createScene(root):
    root.gravity.value = [-9810, 0, 0]
    root.addObject("EulerImplicitSolver")
    root.addObject("CollisionResponse", response="FrictionContactConstraint", responseParams="mu=0.6")
    root.addObject("LocalMinDistance", alarmDistance=5, contactDistance=1)
    plane = add_loaded(root, "floor", "floor.obj", {"src": "@loader"}, translation=[-122, 0, 0])
    plane.addObject("TriangleCollisionModel", simulated=False, moving=False)
    cube = root.addChild("cube")
    cube.addObject("EulerImplicitSolver")
    cube.addObject("MechanicalObject", template="Rigid3", position=[-112, 60, 10, 0, 0, 0, 1])
    cube.addObject("UniformMass", totalMass=0.001)
    shell = add_loaded(cube, "shell", "cube.obj", scale=9)
    shell.addObject("TriangleCollisionModel")
    shell.addObject("RigidMapping")
    for index, (move, angle) in enumerate((([0, 0, 0], 0), ([0, 120, 20], 180))):
        place = {"translation": move, "rotation": [angle, 0, 180]}
        finger = add_loaded(root, f"finger{index + 1}", "hollow.vtk", **place)
        finger.addObject("EulerImplicitSolver", rayleighStiffness=0.1, rayleighMass=0.1)
        finger.addObject("UniformMass", totalMass=0.04)
        finger.addObject("TetrahedronFEMForceField", poissonRatio=0.3, youngModulus=500)
        finger.addObject("BoxROI", name="root", box=[-1, -21, -1, 1, 1, 21])
        finger.addObject("RestShapeSpringsForceField", points="@../finger1/root.indices", stiffness=1e12)
        chamber = add_loaded(finger, "chamber", "chamber.obj", **place)
        chamber.addObject("SurfacePressureConstraint", name=f"pressure{index + 1}", value=0.0001,
                          triangles="@topo.triangles", valueType="pressure", maxPressure=0.3)
        chamber.addObject("BarycentricMapping")
        skin = add_loaded(finger, "skin", "skin.obj", **place)
        skin.addObject("TriangleCollisionModel", selfCollision=False, group=1)
        skin.addObject("BarycentricMapping")
    root.addObject(Squeeze(node=root))
