"""A bar of hexahedra that the file computes, with static equilibria."""


def createScene(root):
    root.gravity = [0, 0, -9.81]
    bar = root.addChild("bar")
    bar.addObject("StaticSolver")
    points = [[0.1 * x, 0.1 * y, 0.1 * z] for z in range(3) for y in range(3) for x in range(9)]
    corners = [0, 1, 10, 9, 27, 28, 37, 36]
    hexahedra = [[x + 9 * y + 27 * z + corner for corner in corners] for z in range(2) for y in range(2) for x in range(8)]
    bar.addObject("MeshTopology", name="grid", position=points, hexahedra=hexahedra)
    bar.addObject("MechanicalObject", template="Vec3d")
    bar.addObject("MeshMatrixMass", massDensity=1000)
    bar.addObject("HexahedronFEMForceField", youngModulus=1e6, poissonRatio=0.3, method="large")
    bar.addObject("BoxROI", name="end", box="-0.01 -0.01 -0.01 0.01 0.21 0.21")
    bar.addObject("FixedConstraint", indices="@end.indices")
