def createScene(root):
    root.gravity = [0, -9810, 0]
    bar = root.addChild("bar")
    bar.addObject("EulerImplicitSolver")
    bar.addObject("MeshVTKLoader", name="loader", filename="mesh/bar.vtk")
    bar.addObject("MeshTopology", src="@loader")
    bar.addObject("MechanicalObject")
    bar.addObject("TetrahedronFEMForceField", youngModulus=600, poissonRatio=0.3)
    bar.addObject("FixedProjectiveConstraint", indices=[0, 1, 2, 3])
    bar.nothing.here = 1
