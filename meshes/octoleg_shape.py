"""The Octoleg's shape: the sections that all of its meshes share, and the contacts of its notches.

The published figures of the robot are its bounding box, its cable's points, and a point near each
notch. The rest is chosen: the mass comes to the published 0.024 kg at 1070 kg/m³.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

# The cable's points (x, z) in order [mm], at y = 0, after the pull point (40, 2). The first one is
# followed by pairs of points on the flanks of each notch.
CABLE_POINTS = np.array(
    [
        (48.27, 24.54), (66.97, 13.55), (70.52, 11.88), (82.09, 6.00), (84.77, 3.42),
        (96.34, -4.23), (99.91, -7.67), (111.52, -20.65), (114.19, -23.23), (124.02, -36.26),
        (125.82, -39.75), (133.88, -54.61), (135.68, -58.10), (142.85, -72.09), (143.76, -74.73),
    ]
)  # fmt: skip
# Contact points of the notches, (x, z) [mm]: tips of the flanks nearer to the root.
CONTACT_POINTS = np.array(
    [(64, 11), (78, 3), (93, -7.5), (107, -23), (118, -38), (129.5, -55.5), (138, -73)]
)
# The cable's points lie this deep inside the flanks, and inside the root's face [mm].
COVER = 0.2
# Corners of a section: back −y, back +y, floor −y, floor +y, keel.
BACK_LEFT, BACK_RIGHT, FLOOR_LEFT, FLOOR_RIGHT, KEEL = range(5)


@dataclass(frozen=True)
class OctolegShape:
    """Dimensions of the Octoleg [mm].

    Attributes:
        lowest_x: Least x, at the root's keel.
        highest_x: Greatest x, at the tip's back.
        lowest_z: Least z, at the tip's keel.
        highest_z: Greatest z, at the root's back.
        half_widths: Half the width at the root and at the tip.
        back_at_last_notch: From the cable to the back at the last notch.
        hinge_share: Height of a hinge as a share of the distance from cable to back.
        notch_flare: How much wider a notch is at its mouth than at the cable.
        hinge_spread: Length of a hinge along the back.
        tip_height: From keel to back at the tip.
        tip_direction: Angle of the tip's end below the x axis [degrees].
    """

    lowest_x: float = 41.8
    highest_x: float = 165.0
    lowest_z: float = -102.0
    highest_z: float = 37.0
    half_widths: tuple[float, float] = (9.2, 5.0)
    back_at_last_notch: float = 6.5
    hinge_share: float = 0.5
    notch_flare: float = 0.8
    hinge_spread: float = 7.0
    tip_height: float = 8.0
    tip_direction: float = 60.0


def sections(shape: OctolegShape = OctolegShape()) -> tuple[np.ndarray, np.ndarray]:
    """The sections that all refinements share.

    Args:
        shape: Dimensions of the body.

    Returns:
        Corners of each section in the layout's order [mm], shape (section_count, 5, 3), and
        whether a notch follows each section but the last.
    """
    outlines = [*_root(shape), *_flanks(shape)]
    notch_count = len(CONTACT_POINTS)
    outlines += _tip(outlines[-1], shape)
    in_notch = np.zeros(len(outlines) - 1, dtype=bool)
    in_notch[2 : 2 + 2 * notch_count : 2] = True
    keel, floor, back = np.array(outlines).transpose(1, 0, 2)
    middle = 0.5 * (keel + back)
    travelled = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(middle, axis=0), axis=1))])
    root, tip = shape.half_widths
    half = root + (tip - root) * travelled / travelled[-1]

    def standing(plane: np.ndarray, y: np.ndarray) -> np.ndarray:
        return np.stack([plane[:, 0], y, plane[:, 1]], axis=1)

    corners = [
        standing(back, -half), standing(back, half),
        standing(floor, -half), standing(floor, half), standing(keel, 0.0 * half),
    ]  # fmt: skip
    return np.stack(corners, axis=1), in_notch


def _normal(direction: np.ndarray) -> np.ndarray:
    """Unit normal towards the back, for a direction towards the tip."""
    return np.array([-direction[1], direction[0]]) / np.linalg.norm(direction)


def _root(shape: OctolegShape) -> list[tuple]:
    """Keel, floor and back (x, z) [mm] of the root's face and of a section behind it."""
    direction = CABLE_POINTS[1] - CABLE_POINTS[0]
    normal = _normal(direction)
    face = CABLE_POINTS[0] - COVER * direction / np.linalg.norm(direction)
    inner = (face[0] - shape.lowest_x) / normal[0]
    outer = (shape.highest_z - face[1]) / normal[1]
    floor = outer * (1.0 - shape.hinge_share)
    root = (face - inner * normal, face + floor * normal, face + outer * normal)
    first = _flanks(shape)[0]
    between = tuple(0.5 * (a + b) for a, b in zip(root, first, strict=True))
    return [root, between]


def _flanks(shape: OctolegShape) -> list[tuple]:
    """Keel, floor and back (x, z) [mm] of the two flanks of each notch."""
    pairs = CABLE_POINTS[1:].reshape(-1, 2, 2)
    middles = pairs.mean(axis=1)
    along = np.gradient(np.vstack([CABLE_POINTS[:1], middles]), axis=0)[1:]
    arc_length = np.linalg.norm(np.diff(np.vstack([CABLE_POINTS[:1], middles]), axis=0), axis=1).cumsum()
    first_outer = shape.highest_z - CABLE_POINTS[0, 1]
    outer = first_outer + (shape.back_at_last_notch - first_outer) * arc_length / arc_length[-1]
    flanks = []
    for pair, middle, tangent, touching, back in zip(
        pairs, middles, along, CONTACT_POINTS, outer, strict=True
    ):
        tangent = tangent / np.linalg.norm(tangent)
        normal = _normal(tangent)
        stretch = pair[1] - pair[0]
        inset = COVER * stretch / np.linalg.norm(stretch)
        mouth = middle - np.dot(middle - touching, normal) * normal
        half_gap = 0.5 * (np.dot(stretch, tangent) + shape.notch_flare) * tangent
        for point, keel, side in (
            (pair[0] + inset, mouth - half_gap, -0.5),
            (pair[1] - inset, mouth + half_gap, 0.5),
        ):
            # The flank is plane, so its cable point lies between keel and floor.
            outwards = point - keel
            rise = back * (1.0 - shape.hinge_share) / np.dot(outwards, normal)
            floor = point + rise * outwards
            spread = side * shape.hinge_spread * tangent
            flanks.append((keel, floor, middle + back * normal + spread))
    return flanks


def _tip(last: tuple, shape: OctolegShape) -> list[tuple]:
    """Keel, floor and back (x, z) [mm] of the sections from the last flank to the tip."""
    angle = np.radians(shape.tip_direction)
    direction = np.array([np.cos(angle), -np.sin(angle)])
    normal = _normal(direction)
    back = np.array([shape.highest_x, 0.0])
    back[1] = shape.lowest_z + shape.tip_height * normal[1]
    keel = back - shape.tip_height * normal
    end = (keel, 0.5 * (keel + back), back)
    return [
        tuple((1.0 - part) * a + part * b for a, b in zip(last, end, strict=True))
        for part in (0.25, 0.5, 0.75, 1.0)
    ]


def contact_pairs(shape: OctolegShape = OctolegShape()) -> np.ndarray:
    """The self-contacts: a point and a triangle of each notch.

    Args:
        shape: Figures of the body.

    Returns:
        Tip of the flank nearer to the root, then keel, floor −y and floor +y of the other flank
        [m], shape (7, 4, 3).
    """
    corners, in_notch = sections(shape)
    first = np.flatnonzero(in_notch)
    others = corners[first + 1][:, [KEEL, FLOOR_LEFT, FLOOR_RIGHT]]
    return 1e-3 * np.concatenate([corners[first][:, [KEEL]], others], axis=1)
