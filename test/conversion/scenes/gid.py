"""A mesh of GiD, whose coordinates lie between words."""


def createScene(root):
    root.gravity = [0, -981, 0]
    bar = root.addChild("bar")
    bar.addObject("EulerImplicitSolver")
    bar.addObject("GIDMeshLoader", name="loader", filename="mesh/bar.gidmsh", scale=0.1)
    bar.addObject("MeshTopology", src="@loader")
    bar.addObject("MechanicalObject", position=bar.loader.position.getLinkPath())
    bar.addObject("UniformMass", totalMass=0.05)
    bar.addObject("TetrahedronFEMForceField", youngModulus=6000, poissonRatio=0.3, method="polar")
    bar.addObject("FixedProjectiveConstraint", indices=[i for i, p in enumerate(bar.loader.position.value) if p[0] < 0.1])
