"""Nodes with a mesh file, for the scenes beside this file."""

LOADERS = {"obj": "MeshOBJLoader", "vtk": "MeshVTKLoader", "msh": "MeshGmshLoader"}


def add_loaded(parent, name, file, state=(), **placement):
    node = parent.addChild(name)
    node.addObject(LOADERS[file[-3:]], name="loader", filename=f"mesh/{file}", **placement)
    node.addObject("MeshTopology", src="@loader", name="topo")
    node.addObject("MechanicalObject", **dict(state))
    return node
