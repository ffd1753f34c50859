"""A bar whose ends are rigid parts; one of them is fixed."""

from stlib3.components import addOrientedBoxRoi
from stlib3.physics.deformable import ElasticMaterialObject
from stlib3.physics.mixedmaterial import Rigidify
from stlib3.scene import Scene


def createScene(root):
    scene = Scene(root, gravity=[0.0, -9810.0, 0.0], dt=0.01)
    bar = ElasticMaterialObject(name="bar", volumeMeshFileName="mesh/bar.vtk", youngModulus=600,
                                poissonRatio=0.4, totalMass=0.05)
    scene.Modelling.addChild(bar)
    bar.dofs.init()
    groups = []
    for index, x in enumerate((0, 100)):
        box = addOrientedBoxRoi(scene.Modelling, position=[list(one) for one in bar.dofs.rest_position.value],
                                name=f"box{index}", translation=[x, 10, 10], eulerRotation=[0, 90, 0],
                                scale=[30, 30, 20])
        box.init()
        groups.append([one for one in box.indices.value])
    made = Rigidify(scene.Modelling, bar, groupIndices=groups, frames=[[0, 10, 10, 0, 0, 0], [0, 0, 0]],
                    name="ends")
    made.RigidParts.addObject("FixedProjectiveConstraint", indices=0)
    scene.Simulation.addChild(made)
