"""A bar with a stiffer lower half, a cable that is pulled, and a controller for keys."""

from keys import CableKeys
from loaded import add_loaded


def createScene(root):
    root.gravity = [0, -9810, 0]
    root.dt = 0.02
    root.addObject("GenericConstraintSolver", maxIterations=500)
    bar = add_loaded(root, "bar", "bar.vtk", {"template": "Vec3"})
    bar.addObject("EulerImplicitSolver", rayleighMass=0.1, rayleighStiffness=0.05)
    bar.addObject("UniformMass", totalMass=0.04)
    bar.addObject("TetrahedronFEMForceField", method="large", poissonRatio=0.3, youngModulus=500)
    bar.addObject("BoxROI", name="root", box=[-1, -1, -1, 1, 21, 21])
    bar.addObject("BoxROI", name="lower", box=[-1, -1, -1, 101, 10, 21], strict=False)
    bar.addObject("RestShapeSpringsForceField", points=bar.root.indices.getLinkPath(), stiffness=1e12)
    layer = bar.addChild("layer")
    layer.addObject("TetrahedronSetTopologyContainer", position="@loader.position",
                    tetrahedra="@lower.tetrahedraInROI")
    layer.addObject("TetrahedronFEMForceField", poissonRatio=0.3, youngModulus=1000)
    cable = bar.addChild("cable")
    cable.addObject("MechanicalObject", position=[[20, 15, 10], [50, 15, 10], [80, 15, 10]])
    cable.addObject("CableConstraint", name="flexor", indices=[0, 1, 2], pullPoint=[0, 15, 10], value=2,
                    minForce=0)
    cable.addObject("BarycentricMapping")
    cable.addObject(CableKeys(node=cable))
