"""An inverse problem: four cables, a goal, a mesh that loader and state place."""


def createScene(root):
    root.addObject("RequiredPlugin", name="SoftRobots.Inverse")
    root.findData("dt").value = 1
    root.findData("gravity").value = [0, 0, -9810]
    root.addObject("FreeMotionAnimationLoop")
    root.addObject("QPInverseProblemSolver")
    goal = root.addChild("goal")
    goal.addObject("EulerImplicitSolver", firstOrder=True)
    goal.addObject("MechanicalObject", name="place", position=[[0, 0, 122]])
    goal.addObject("SphereCollisionModel", radius=5, group=1)
    robot = root.addChild("robot")
    robot.addObject("EulerImplicitSolver")
    robot.addObject("SparseLDLSolver")
    robot.addObject("MeshVTKLoader", name="loader", filename="mesh/diamond.vtk")
    robot.addObject("MeshTopology", src="@loader")
    robot.addObject("MechanicalObject", rx=90, dz=35)
    robot.addObject("UniformMass", totalMass=0.5)
    robot.addObject("TetrahedronFEMForceField", youngModulus=180, poissonRatio=0.45)
    robot.addObject("BoxROI", box=[-15, -15, -40, 15, 15, 10])
    robot.addObject("FixedProjectiveConstraint", indices="@BoxROI.indices")
    points = robot.addChild("points")
    points.addObject("MechanicalObject", position=[[0, 0, 125], [0, 97, 45], [-97, 0, 45], [0, -97, 45],
                                                   [97, 0, 45]])
    points.addObject("PositionEffector", name="tip", indices=[0], effectorGoal="@../../goal/place.position")
    for index, place in enumerate([[0, 10, 30], [-10, 0, 30], [0, -10, 30], [10, 0, 30]]):
        points.addObject("CableActuator", name=f"cable{index}", indices=index + 1, pullPoint=place,
                         maxPositiveDisp=20, minForce=0)
    points.addObject("BarycentricMapping", mapForces=False, mapMasses=False)
