"""A bar of hexahedra from a grid, with small displacements and static equilibria."""


def createScene(root):
    root.gravity = [0, 0, -9.81]
    bar = root.addChild("bar")
    bar.addObject("StaticSolver")
    bar.addObject("RegularGridTopology", name="grid", n=[9, 3, 3], min=[0, 0, 0], max=[0.8, 0.2, 0.2])
    bar.addObject("MechanicalObject", template="Vec3d")
    bar.addObject("MeshMatrixMass", massDensity=1000)
    bar.addObject("HexahedronFEMForceField", youngModulus=1e6, poissonRatio=0.3, method="large")
    bar.addObject("BoxROI", name="end", box="-0.01 -0.01 -0.01 0.01 0.21 0.21")
    bar.addObject("FixedConstraint", indices="@end.indices")
