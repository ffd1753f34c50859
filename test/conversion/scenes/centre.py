"""Motion without inertia; the mean of a patch follows a goal; a chamber is inflated by volume."""

from loaded import add_loaded


def createScene(root):
    root.dt = 0.05
    root.gravity = [0, 0, 0]
    goal = root.addChild("goal")
    goal.addObject("EulerImplicitSolver", firstOrder=True)
    goal.addObject("MechanicalObject", name="place", position="100 12 10")
    bar = add_loaded(root, "bar", "hollow.vtk", {"position": "@loader.position"})
    bar.addObject("EulerImplicitSolver", firstOrder=True)
    bar.addObject("DiagonalMass", massDensity=1e-6)
    bar.addObject("TetrahedronFEMForceField", youngModulus=200, poissonRatio=0.45)
    bar.addObject("FixedProjectiveConstraint", indices=[0, 1, 2, 3, 4])
    patch = bar.addChild("patch")
    patch.addObject("MechanicalObject", position=[[100, 0, 0], [100, 20, 0], [100, 0, 20], [100, 20, 20]])
    patch.addObject("BarycentricCenterEffector", effectorGoal="@../../goal/place.position")
    patch.addObject("BarycentricMapping")
    chamber = add_loaded(bar, "chamber", "chamber.obj")
    chamber.addObject("SurfacePressureActuator", name="air", maxPressure=30, minPressure=0)
    chamber.addObject("BarycentricMapping")
