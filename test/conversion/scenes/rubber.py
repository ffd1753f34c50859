"""A hyperelastic bar on a soft ground of springs, with a sphere that is fixed."""


def createScene(root):
    root.gravity = [0, 0, -9810]
    bar = root.addChild("bar")
    bar.addObject("EulerImplicitSolver")
    bar.addObject("MeshGmshLoader", name="loader", filename="mesh/bar.msh")
    bar.addObject("TetrahedronSetTopologyContainer", src="@loader")
    bar.addObject("MechanicalObject", scale=0.5)
    bar.addObject("MeshMatrixMass", totalMass=0.02)
    bar.addObject("TetrahedronHyperelasticityFEMForceField", materialName="MooneyRivlin",
                  ParameterSet="60 20 4000")
    bar.addObject("SphereROI", name="root", centers=[0, 5, 5], radii=8)
    bar.addObject("FixedProjectiveConstraint", indices="@root.indices")
    bar.addObject("BoxROI", name="ground", box=[25, -1, -0.1, 51, 11, 0.1])
    bar.addObject("RestShapeSpringsForceField", points="@ground.indices", stiffness=3.0)
