"""Components and fields that have no counterpart, and a value of a module that nobody has."""

import a_module_that_nobody_has
from loaded import add_loaded


def createScene(root):
    root.gravity = [0, -9810, 0]
    bar = add_loaded(root, "bar", "bar.vtk")
    bar.addObject("EulerImplicitSolver")
    bar.addObject("UniformMass", totalMass=0.05)
    bar.addObject("TetrahedronFEMForceField", youngModulus=600, poissonRatio=0.3, plasticMaxThreshold=0.1)
    bar.addObject("FixedProjectiveConstraint", indices=[0, 1, 2, 3])
    bar.addObject("PartialFixedProjectiveConstraint", indices=[7], fixedDirections=[1, 0, 0])
    bar.addObject("ConstantForceField", totalForce=[0, 0, a_module_that_nobody_has.push])
    cable = bar.addChild("cable")
    cable.addObject("MechanicalObject", position=[[50, 10, 10]])
    cable.addObject("CableConstraint", pullPoint=a_module_that_nobody_has.winch)
    cable.addObject("ForcePointActuator", initForce=2.0)
    cable.addObject("BarycentricMapping")
    bar.addObject("IndexValueMapper", name="layers", indices=[0], value=600)
    bar.addObject("UnilateralPlaneConstraint", indices=[0, 1, 2, 3])
    bar.addObject("RegularGridTopology", n=[2, 2, 2])
