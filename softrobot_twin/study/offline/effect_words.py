"""Entries of a scene file in words with units."""

from __future__ import annotations

import numpy as np


def count(things, name: str) -> str:
    """How many there are: ``3 nodes``, ``1 node``."""
    return f"{len(things)} {name}{'' if len(things) == 1 else 's'}"


def number(value: float) -> str:
    """A number as short as it may be."""
    return f"{value:.6g}"


def vector(values) -> str:
    """Numbers in brackets."""
    return "[" + ", ".join(number(float(value)) for value in values) + "]"


def millimetres(values) -> str:
    """Lengths in m, said in mm."""
    return f"{vector(1e3 * np.atleast_1d(values))} mm"


def limits(bounds, unit: str) -> str:
    """A lower and an upper limit, each of which may be infinite."""
    if np.isfinite(bounds).any():
        return f"{vector(bounds)} {unit}"
    return "without limit"


def mesh_words(mesh) -> str:
    """A mesh entry."""
    words = [str(mesh.file)]
    if mesh.scale != 1.0:
        words.append(f"scale {number(mesh.scale)}")
    if any(mesh.rotation):
        words.append(f"rotation {vector(mesh.rotation)} rad")
    if any(mesh.translation):
        words.append(f"translation {vector(mesh.translation)} m")
    return ", ".join(words)


def material_words(material) -> str:
    """A material entry."""
    weighed = (f"{number(material.density)} kg/m³" if material.total_mass is None
               else f"{number(material.total_mass)} kg in all")
    return (f"{material.law}, E {number(material.young_modulus)} Pa, "
            f"ν {number(material.poisson_ratio)}, {weighed}")


def cable_words(cable) -> str:
    """A cable entry."""
    words = [count(cable.points, "point"), f"pulled from the {cable.pull_point_on}",
             f"shortening {limits(1e3 * np.array(cable.shortening), 'mm')}",
             f"tension {limits(cable.tension, 'N')}"]
    if cable.rate is not None and np.isfinite(cable.rate):
        words.append(f"rate {number(1e3 * cable.rate)} mm/s")
    return ", ".join(words)


def effector_words(effector) -> str:
    """An effector entry."""
    return (f"{count(effector.points, 'point')}, directions {' '.join(effector.directions)}, "
            f"weight {number(effector.weight)}")


def shape_words(entry) -> str:
    """The one shape of an obstacle or a rigid body."""
    shape = entry.shape
    kind = type(shape).__name__.removesuffix("Shape").lower()
    if kind == "plane":
        return f"plane, normal {vector(shape.normal)}"
    if kind == "box":
        return f"box of {millimetres(shape.size)}"
    if kind == "surface":
        return f"surface {shape.file}"
    words = f"{kind} of radius {number(1e3 * shape.radius)} mm"
    if kind in ("capsule", "cylinder"):
        length = np.linalg.norm(np.subtract(*shape.ends))
        words += f", {number(1e3 * length)} mm long"
    return words


def rigid_words(entry) -> str:
    """A rigid body entry."""
    words = [entry.motion, shape_words(entry)]
    if entry.mass is not None:
        words.append(f"{number(entry.mass)} kg")
    if entry.density is not None:
        words.append(f"{number(entry.density)} kg/m³")
    if entry.speed is not None:
        words.append(f"at most {number(1e3 * entry.speed)} mm/s")
    if entry.turn_rate is not None:
        words.append(f"at most {number(entry.turn_rate)} rad/s")
    return ", ".join(words)


def spring_words(spring) -> str:
    """A spring entry."""
    words = [f"{spring.ends[0].on} to {spring.ends[1].on}", f"{number(spring.stiffness)} N/m"]
    if spring.damping > 0.0:
        words.append(f"{number(spring.damping)} N s/m")
    return ", ".join(words)


def mass_spring_words(entry) -> str:
    """A mass-spring body entry."""
    return (f"{count(entry.points, 'point')}, {count(entry.springs, 'spring')} of "
            f"{number(entry.stiffness)} N/m")


def contact_words(contact) -> str:
    """What all contacts of a scene have in common."""
    return (f"watched below {number(1e3 * contact.alarm_distance)} mm, touching below "
            f"{number(1e3 * contact.contact_distance)} mm, solved to "
            f"{number(contact.tolerance)} m")
