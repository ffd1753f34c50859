"""The kinds of elements that scenes may name (``element``).

An element is a mesh class, see `CellMesh`, with its own `ShapeFunctions`. Its kind makes such a mesh
of the cells of a file: of tetrahedra, or of hexahedra and the tetrahedra beside them. A new kind is
registered by one call of `register_element`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from softrobot_twin.geometry.cell_mesh import CellMesh
from softrobot_twin.geometry.quadratic_mesh import add_mid_edge_nodes
from softrobot_twin.geometry.smoothed_mesh import smooth


class ElementKind(NamedTuple):
    """A kind of elements.

    Attributes:
        name: Its name in scenes.
        make_mesh: Makes a mesh of such elements with the shape of the cells of a file.
        lumps_mass: Whether mass is lumped unless a scene says otherwise; else it is consistent.
        of_hexahedra: Whether these cells are a `HexahedralMesh`; else they are a `TetMesh`.
        has_patches: Whether patches resist changes of volume unless a scene says otherwise, where the
            law can be divided; else every element does.
    """

    name: str
    make_mesh: Callable[[CellMesh], CellMesh]
    lumps_mass: bool
    of_hexahedra: bool
    has_patches: bool


HEXAHEDRAL = "hexahedral"
"""Name of the kind that files with hexahedra get where a scene does not name one."""
# The elements by name; `register_element` adds to them.
ELEMENT_KINDS: dict[str, ElementKind] = {}


def register_element(
    name: str, make_mesh: Callable[[CellMesh], CellMesh], lumps_mass: bool = False,
    of_hexahedra: bool = False, has_patches: bool = False,
) -> None:  # fmt: skip
    """Register a kind of elements for scenes.

    Args:
        name: Its name in scenes.
        make_mesh: Makes a mesh of such elements with the shape of the cells of a file.
        lumps_mass: Whether mass is lumped unless a scene says otherwise.
        of_hexahedra: Whether these cells are a `HexahedralMesh`; else they are a `TetMesh`.
        has_patches: Whether patches resist changes of volume unless a scene says otherwise.

    Raises:
        ValueError: Another kind has this name.
    """
    if name in ELEMENT_KINDS:
        raise ValueError(f"the element {name!r} is registered already")
    ELEMENT_KINDS[name] = ElementKind(name, make_mesh, lumps_mass, of_hexahedra, has_patches)


def element_names() -> tuple[str, ...]:
    """Names of all kinds."""
    return tuple(ELEMENT_KINDS)


def element_named(name: str) -> ElementKind:
    """The kind of a name.

    Args:
        name: Its name in scenes, such as ``linear``.

    Raises:
        KeyError: There is none.
    """
    if name not in ELEMENT_KINDS:
        raise KeyError(f"no element is named {name!r}; there are {', '.join(ELEMENT_KINDS)}")
    return ELEMENT_KINDS[name]


register_element("linear", lambda mesh: mesh, lumps_mass=True)
register_element("smoothed", smooth, lumps_mass=True, has_patches=True)
register_element("quadratic", add_mid_edge_nodes)
register_element(HEXAHEDRAL, lambda mesh: mesh, lumps_mass=True, of_hexahedra=True)
