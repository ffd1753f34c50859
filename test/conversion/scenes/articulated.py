"""An arm on a hinge with a motor, whose tip follows a goal."""


def createScene(root):
    root.gravity = [0, -9810, 0]
    root.addObject("QPInverseProblemSolver")
    robot = root.addChild("robot")
    robot.addObject("EulerImplicitSolver")
    angles = robot.addChild("angles")
    angles.addObject("MechanicalObject", name="dofs", template="Vec1", position=0.0)
    angles.addObject("JointActuator", name="elbow", index=0, maxAngle=1.0, minAngle=-1.0, maxAngleVariation=0.01)
    frames = angles.addChild("frames")
    frames.addObject("MechanicalObject", template="Rigid3", name="dofs",
                     position=[[0, 0, 0, 0, 0, 0, 1], [45, 0, 0, 0, 0, 0, 1]])
    frames.addObject("FixedProjectiveConstraint", indices=0)
    frames.addObject("UniformMass", totalMass=0.02)
    frames.addObject("ArticulatedSystemMapping", input1=angles.dofs.getLinkPath(), output=frames.dofs.getLinkPath())
    tip = frames.addChild("tip")
    tip.addObject("MechanicalObject")
    tip.addObject("PositionEffector", indices=0, effectorGoal=[[40, 20, 0]], useDirections=[1, 1, 0])
    tip.addObject("RigidMapping", index=1)
    angles.addObject("ArticulatedHierarchyContainer")
    centre = angles.addChild("hinges").addChild("hinge")
    centre.addObject("ArticulationCenter", parentIndex=0, childIndex=1, posOnParent=[0, 0, 0], posOnChild=[-45, 0, 0])
    articulation = centre.addChild("articulations")
    articulation.addObject("Articulation", translation=False, rotation=True, rotationAxis=[0, 0, 1],
                           articulationIndex=0)
