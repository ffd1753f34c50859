"""A hyperelastic bar on a soft ground of springs, with a sphere that is fixed."""

from loaded import add_loaded


def createScene(root):
    root.gravity = [0, 0, -9810]
    bar = add_loaded(root, "bar", "bar.msh", {"scale": 0.5})
    bar.addObject("EulerImplicitSolver")
    bar.addObject("MeshMatrixMass", totalMass=0.02)
    bar.addObject("TetrahedronHyperelasticityFEMForceField", materialName="MooneyRivlin",
                  ParameterSet="60 20 4000")
    bar.addObject("SphereROI", name="root", centers=[0, 5, 5], radii=8)
    bar.addObject("FixedProjectiveConstraint", indices="@root.indices")
    bar.addObject("BoxROI", name="ground", box=[25, -1, -0.1, 51, 11, 0.1])
    bar.addObject("RestShapeSpringsForceField", points="@ground.indices", stiffness=3.0)
