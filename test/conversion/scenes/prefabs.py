"""A bar from prefabs of a helper package, with a cable that ends in the body."""

from softrobots.actuators import PullingCable
from stlib3.physics.constraints import FixedBox
from stlib3.physics.deformable import ElasticMaterialObject
from stlib3.scene import Scene
from stlib3.visuals import VisualModel


def createScene(root):
    scene = Scene(root, gravity=[0.0, -9810.0, 0.0], dt=0.01)
    scene.VisualStyle.displayFlags = "showBehavior"
    scene.addObject("FreeMotionAnimationLoop")
    bar = ElasticMaterialObject(name="bar", volumeMeshFileName="mesh/bar.vtk", poissonRatio=0.45,
                                youngModulus=600, totalMass=0.05, translation=[0, 5, 0])
    root.addChild(bar)
    FixedBox(bar, atPositions=[-1, -1, -1, 1, 30, 30])
    PullingCable(bar, name="cable", cableGeometry=[[20, 20, 10], [90, 20, 10]], valueType="force",
                 initialValue=0.001)
    bar.addChild(VisualModel(visualMeshPath="mesh/none.stl"))
