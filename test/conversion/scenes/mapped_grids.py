"""Grids by their ends, cells that a mapping makes elsewhere, and a body whose middle is rigid."""

import Sofa
from splib3.numerics import Quat, Vec3, pi


def createScene(root):
    root.dt = 0.01
    root.gravity = [0, -9810, 0]
    with root.addChild("shape") as shape:
        shape.addObject("RegularGridTopology", name="grid", nx=7, ny=3, nz=3, xmin=10, xmax=70, ymin=0, ymax=20,
                        zmin=-10, zmax=10)
        shape.addObject("TetrahedronSetTopologyContainer", name="tetras", position="@grid.position")
        shape.addObject("Hexa2TetraTopologicalMapping", input="@grid", output="@tetras", swapping=True)
    with root.addChild("bar") as bar:
        bar.addObject("EulerImplicitSolver")
        bar.addObject("TetrahedronSetTopologyContainer", name="cells", position="@../shape/grid.position",
                      tetrahedra="@../shape/tetras.tetrahedra")
        bar.addObject("MechanicalObject", name="dofs", src="@cells")
        bar.addObject("TetrahedronFEMForceField", youngModulus=600, poissonRatio=0.4)
        bar.addObject("UniformMass", totalMass=0.05)
        bar.addObject("BoxROI", name="free", box=[11, -1, -11, 71, 21, 11])
        bar.addObject("ComplementaryROI", name="root", setIndices1="@free.indices")
        bar.addObject("FixedProjectiveConstraint", indices="@root.indices")
        cable = bar.addChild("cable")
        turn = Quat.createFromEuler([0., 0., pi / 2])
        cable.addObject("MechanicalObject", position=[
            Vec3(10., -x, 0.).rotateFromQuat(turn).toList() for x in (60., 40.)])
        cable.addObject("CableConstraint", name="pull", indices=[0, 1], pullPoint=[0, 10, 0], minForce=0)
        cable.addObject("BarycentricMapping")
        far = bar.addChild("far")
        far.addObject("MechanicalObject", position=[[900, 10, 0]])
        far.addObject("CableConstraint", name="far", indices=[0], pullPoint=[0, 10, 0], value=3, minForce=0)
        far.addObject("BarycentricMapping")
    with root.addChild("beam") as beam:
        beam.addObject("EulerImplicitSolver")
        grid = beam.addObject("RegularGridTopology", name="grid", n=[3, 3, 9], min=[100, 0, 0], max=[120, 20, 80])
        beam.addObject("MechanicalObject", name="dofs")
        rigid = beam.addObject("BoxROI", name="middle", box=[99, -1, 29, 121, 21, 51], position=grid.position)
        inside, outside = rigid.indices.value.astype(int), rigid.indicesOut.value.astype(int)
        pairs = [[0, 0]] * 81
        for part, chosen in enumerate((outside, inside)):
            for own, node in enumerate(chosen):
                pairs[node] = [part, own]
        with beam.addChild("parts") as parts:
            parts.addObject("MechanicalObject", name="soft", position=rigid.pointsOutROI)
            parts.addObject("BoxROI", name="end", box=[99, -1, -1, 121, 21, 1])
            parts.addObject("FixedProjectiveConstraint", indices="@end.indices")
            with parts.addChild("frame") as frame:
                frame.addObject("MechanicalObject", name="frame", template="Rigid3", position=[110, 10, 40, 0, 0, 0, 0])
                with frame.addChild("carried") as carried:
                    carried.addObject("MechanicalObject", name="carried", position=rigid.pointsInROI)
                    carried.addObject("RigidMapping", globalToLocalCoords=True)
            with parts.addChild("join") as join:
                join.addObject("SubsetMultiMapping", input="@../soft @../frame/carried/carried", output="@../../dofs",
                               indexPairs=pairs)
        with beam.addChild("physics") as physics:
            physics.addObject("NodalMassDensity", property=1e-6)
            physics.addObject("FEMMass", template="Vec3,Hexahedron", topology=grid.linkpath)
            physics.addObject("CorotationalFEMForceField", template="Vec3,Hexahedron", youngModulus=900,
                              poissonRatio=0.3, topology=grid.linkpath)
