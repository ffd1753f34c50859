"""A beam of frames that is clamped at its first one, a cable beside it, and its tip as effector."""


def createScene(root):
    root.gravity = [0, 0, -9810]
    root.addObject("QPInverseProblemSolver")
    beam = root.addChild("rod")
    beam.addObject("EulerImplicitSolver")
    beam.addObject("MeshTopology", edges=[[i, i + 1] for i in range(8)])
    beam.addObject("MechanicalObject", template="Rigid3", name="frames",
                   position=[[10 * i, 0, 0, 0, 0, 0, 1] for i in range(9)])
    beam.addObject("BeamInterpolation", crossSectionShape="rectangular", lengthY=4, lengthZ=6,
                   defaultYoungModulus=2e5, defaultPoissonRatio=0.4)
    beam.addObject("AdaptiveBeamForceFieldAndMass", computeMass=1, massDensity=1e-6)
    beam.addObject("RestShapeSpringsForceField", points=0, stiffness=1e12, angularStiffness=1e12)
    beam.addObject("PositionEffector", name="tip", template="Rigid3", indices=8, useDirections=[1, 0, 1, 0, 0, 0],
                   effectorGoal=[[79, 0, 5, 0, 0, 0, 1]])
    cable = beam.addChild("cables")
    cable.addObject("MechanicalObject", position=[[10 * i, 0, 5] for i in range(1, 9)])
    cable.addObject("CableActuator", name="upper", indices=list(range(8)), pullPoint=[0, 0, 5], minForce=0)
    cable.addObject("AdaptiveBeamMapping")
