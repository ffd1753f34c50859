"""The protocol of a law: the response of a material at one point, independent of the element.

A law is one small file (`laws/`): a NamedTuple of parameters and three kernels on 3×3 matrices
(tuples of rows, see `geometry/matrix3.py`), registered by one call of `register_law`:

    energy_density(law, F)     Ψ [J/m³]
    stress(law, F)             P = ∂Ψ/∂F, first Piola-Kirchhoff [Pa]
    differential(law, F, dF)   dP = ∂P/∂F : dF [Pa]

F is the deformation gradient, F = 1 at rest. `element_assembly.py` calls the kernels at every
quadrature point of every kind of element, and numba compiles it anew for each law.

Two things may be added:

- A law that `turns` is evaluated in the frame that rotates with the material: its kernels get F Rᵀ,
the left stretch, with the rotation R of F = R S, and return P Rᵀ. The elements compute R once per
state. So small-strain laws become corotational ones.
- `linearize(law, F, upright, projected)` is called once per point. It returns the rows, each a
  vector, that `differential` gets in place of F: any number of them, so that what depends on F
  alone is computed once. A law that `projects` is responsible for the projection: where
  `projected` is true its differential must be positive semidefinite, dF : dP ≥ 0. The 9×9 matrix
  of derivatives of another law is tested, and projected only where it has a negative eigenvalue:
  in the axes of the stretches where the law is isotropic, else by eigenvalues of this matrix.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

from numba.extending import overload

from softrobot_twin.kernels.compilation import GENERIC, njit
from softrobot_twin.mechanics.material import lame_parameters

# Without it the kernels would be called, not inlined, at twice the time.
_INLINED = {"forceinline": True}


class LawConstant(NamedTuple):
    """A constant of a law, which scenes give under ``constants``.

    Attributes:
        name: Its name.
        unit: Its unit, ``Pa``; empty for a number.
        is_list: Whether it has one value for each of any number of terms.
    """

    name: str
    unit: str
    is_list: bool = False


class OwnConstants(NamedTuple):
    """How a law is made from constants of its own, in place of Young's modulus.

    Attributes:
        constants: What they are.
        shear_modulus: Gives µ at rest [Pa] of a mapping of all of them by name; raises ValueError,
            which says why, where they do not fit each other.
        parameters: Makes the parameters from such a mapping and the bulk modulus [Pa].
        bulk_modulus: Gives κ at rest [Pa] of laws whose constants say it; None where a scene gives
            it or Poisson's ratio.
    """

    constants: tuple[LawConstant, ...]
    shear_modulus: Callable[[Mapping], float]
    parameters: Callable[[Mapping, float], tuple]
    bulk_modulus: Callable[[Mapping], float] | None = None


class PointLaw(NamedTuple):
    """The properties of a registered law.

    Attributes:
        name: Its name in scenes (``material.law``).
        parameters: The NamedTuple of its parameters: floats, or tuples of them.
        energy_density: The kernel, compiled as the others by ``@njit(**KERNEL, forceinline=True)``
            of `softrobot_twin.kernels.compilation`.
        stress: The kernel.
        differential: The kernel.
        linearize: The kernel; without it F itself is given to `differential`.
        projects: Whether this kernel projects the differential.
        turns: Whether the kernels see the material from the frame that turns with it.
        is_isotropic: Whether the response is the same in all directions at rest: the projection
            is then made in the axes of the stretches, which is faster.
        is_linear: Whether the differential is the same in every state: the stiffness is then
            summed only once.
        of_moduli: Makes the parameters from E [Pa] and ν; when left out they are Lamé's constants.
            None for a law with constants of its own.
        own: Constants of its own, in place of E and ν.
        at_point: The kernel that gives the law at a point, ``at_point(law, k, q, e)``, where the
            parameters hold arrays of what points remember: it is of a type that is registered too.
            Batches k are those of `element_batches.py`.
        is_law_of_scenes: False for a law that only others are wrapped in.
        second_stress: The kernel that gives S, second Piola-Kirchhoff, of Green's strain [Pa], where S is
            linear in it: such laws share the kernels of `laws/saint_venant_kirchhoff.py`.
    """

    name: str
    parameters: type
    energy_density: Callable
    stress: Callable
    differential: Callable
    linearize: Callable | None = None
    projects: bool = False
    turns: bool = False
    is_isotropic: bool = False
    is_linear: bool = False
    of_moduli: Callable[[float, float], tuple] | None = None
    own: OwnConstants | None = None
    at_point: Callable | None = None
    is_law_of_scenes: bool = True
    second_stress: Callable | None = None


LAWS: dict[type, PointLaw] = {}


def register_law(name: str, parameters: type, *kernels: Callable, **properties) -> None:
    """Register a law for elements and scenes.

    Args:
        name: Its name in scenes.
        parameters: The NamedTuple of its parameters.
        kernels: `energy_density`, `stress`, `differential` and, if there is one, `linearize`.
        properties: Other fields of `PointLaw`.

    Raises:
        ValueError: Another law has this name, or these parameters.
    """
    taken = [law.name for law in LAWS.values()]
    if name in taken or parameters in LAWS:
        raise ValueError(f"the law {name!r} or its {parameters.__name__} is registered already")
    law = PointLaw(name, parameters, *kernels, **properties)
    if law.of_moduli is None and law.own is None:
        law = law._replace(of_moduli=lambda E, nu: parameters(*lame_parameters(E, nu)))
    LAWS[parameters] = law


def law_names() -> tuple[str, ...]:
    """Names of all laws of scenes."""
    return tuple(law.name for law in LAWS.values() if law.is_law_of_scenes)


def law_named(name: str) -> PointLaw:
    """The law of a name.

    Args:
        name: Its name in scenes, such as ``neo_hookean``.

    Raises:
        KeyError: There is none.
    """
    for law in LAWS.values():
        if law.name == name and law.is_law_of_scenes:
            return law
    raise KeyError(f"no law is named {name!r}; there are {', '.join(law_names())}")


def has_bulk_modulus(parameters: type) -> bool:
    """Whether a law's energy is one of shape and κ U(J), with a parameter `bulk_modulus`.

    Then its volume may be that of patches, and its shape may be viscous or soften.

    Args:
        parameters: The type of the law's parameters.
    """
    return "bulk_modulus" in getattr(parameters, "_fields", ())


def can_divide(parameters: type) -> bool:
    """Whether patches can resist changes of volume in place of a law; see `patch_volumes.py`.

    Args:
        parameters: The type of the law's parameters.
    """
    return has_bulk_modulus(parameters) or hasattr(parameters, "with_bulk_modulus")


def law_of(parameters: tuple) -> PointLaw:
    """The law that parameters belong to.

    Args:
        parameters: Parameters of a law, as its kernels take them.

    Raises:
        KeyError: Their type is not registered.
    """
    return _law_of_type(type(parameters))


def _law_of_type(parameters: type) -> PointLaw:
    if parameters not in LAWS:
        raise KeyError(f"{parameters.__name__} are the parameters of no registered law")
    return LAWS[parameters]


def _kernel(name: str, otherwise: Callable | None = None) -> Callable:
    """Make the function that calls a kernel of a law inside kernels.

    Args:
        name: Field of `PointLaw`.
        otherwise: The kernel of laws without it.
    """

    def of_law(law, *arguments):
        raise NotImplementedError("only inside compiled kernels")

    @overload(of_law, jit_options=_INLINED)
    def chosen(law, *arguments):
        kernel = getattr(_law_of_type(law.instance_class), name) or otherwise
        return lambda law, *arguments: kernel(law, *arguments)

    return of_law


@njit(**GENERIC)
def _unchanged(law, k, q, e):
    """A law that is the same at all points."""
    return law


@njit(**GENERIC)
def _not_linearized(law, F, upright, projected):
    """F itself is what the differential takes."""
    return F


law_at = _kernel("at_point", _unchanged)
"""``law_at(law, k, q, e)``: the law at point q of element e of batch k."""
energy_density = _kernel("energy_density")
"""``energy_density(law, F)``: Ψ [J/m³]."""
stress = _kernel("stress")
"""``stress(law, F)``: P [Pa]."""
linearize = _kernel("linearize", _not_linearized)
"""``linearize(law, F, upright, projected)``: the rows that `differential` takes. `upright` tells whether
the point is not inside out, `projected` whether the differential must be positive semidefinite."""
differential = _kernel("differential")
"""``differential(law, linearized, dF)``: dP [Pa]."""
second_stress = _kernel("second_stress")
"""``second_stress(law, E)``: S of Green's strain E [Pa]."""


def _property(name: str) -> Callable:
    """Make the function that gives a property of `PointLaw` inside kernels, where it is a constant."""

    def of_law(law):
        raise NotImplementedError("only inside compiled kernels")

    @overload(of_law, jit_options=_INLINED)
    def constant(law):
        value = getattr(_law_of_type(law.instance_class), name)
        return lambda law: value

    return of_law


law_turns, law_projects, law_is_isotropic = map(_property, ("turns", "projects", "is_isotropic"))
