"""A contact shape that is defined here, outside the package: an ellipsoid."""

from typing import Annotated, ClassVar, NamedTuple

import numpy as np
import pytest
import yaml

from softrobot_twin.errors import SceneError
from softrobot_twin.geometry.mass_properties import MassProperties
from softrobot_twin.geometry.shapes.shape import RollingShape
from softrobot_twin.geometry.vector3 import norm
from softrobot_twin.geometry.vector3 import unit as unit_vector
from softrobot_twin.kernels.compilation import INLINED, KERNEL, njit
from softrobot_twin.scene import load_scene
from softrobot_twin.scene.entry import Vector, unit
from softrobot_twin.scene.schema import register_shape
from softrobot_twin.scene.shapes import Length, ShapeEntry, Sphere
from softrobot_twin.simulation import Hold, Simulation
from test.builder import builder
from test.registrations import taken_back

MATERIAL = {"young_modulus": 1.0e5, "poisson_ratio": 0.3, "density": 1000.0}
SIZE, ROUND, STEP, TINY = 0.04, (0.02, 0.02, 0.02), 0.002, 1.0e-12


@njit(**INLINED)
def shares(form, p, s):
    """|p| / (a² - m² + s) along each axis, of the least semi-axis m."""
    least = min(form.a, form.b, form.c)
    return (
        max(abs(p[0]), TINY * form.a) / (form.a**2 - least**2 + s),
        max(abs(p[1]), TINY * form.b) / (form.b**2 - least**2 + s),
        max(abs(p[2]), TINY * form.c) / (form.c**2 - least**2 + s),
    )


@njit(**KERNEL)
def distance_of_ellipsoid(form, p):
    """By the s > 0 with Σ (a p / (a² - m² + s))² = 1, found by halving."""
    low, high = 0.0, norm((form.a * p[0], form.b * p[1], form.c * p[2])) + TINY * form.a**2
    for _ in range(100):
        s = 0.5 * (low + high)
        g = shares(form, p, s)
        if norm((form.a * g[0], form.b * g[1], form.c * g[2])) > 1.0:
            low = s
        else:
            high = s
    way = (abs(p[0]) - form.a**2 * g[0], abs(p[1]) - form.b**2 * g[1], abs(p[2]) - form.c**2 * g[2])
    is_outside = norm((p[0] / form.a, p[1] / form.b, p[2] / form.c)) > 1.0
    gradient = unit_vector((np.copysign(g[0], p[0]), np.copysign(g[1], p[1]), np.copysign(g[2], p[2])))
    return norm(way) if is_outside else -norm(way), gradient


@njit(**KERNEL)
def farthest_of_ellipsoid(form, n):
    """A² n / |A n|."""
    size = norm((form.a * n[0], form.b * n[1], form.c * n[2]))
    return form.a**2 * n[0] / size, form.b**2 * n[1] / size, form.c**2 * n[2] / size


class EllipsoidForm(NamedTuple):
    a: float
    b: float
    c: float

    distance = distance_of_ellipsoid
    farthest = farthest_of_ellipsoid


class Ellipsoid(ShapeEntry, RollingShape):
    """An ellipsoid along the axes."""

    told: ClassVar[tuple[str, ...]] = ("ellipsoid of semi-axes {semi_axes:mm} mm",)

    centre: Vector = (0.0, 0.0, 0.0)
    semi_axes: Annotated[tuple[Length, Length, Length], unit("m")]

    @property
    def curvature_radius(self) -> float:
        return min(self.semi_axes) ** 2 / max(self.semi_axes)

    def frame(self):
        return np.array(self.centre), np.eye(3)

    def form(self):
        return EllipsoidForm(*self.semi_axes)

    def _own_surface(self, resolution):
        points, triangles = Sphere(radius=1.0).surface(resolution / max(self.semi_axes))
        return points * self.semi_axes, triangles

    def _own_mass_properties(self):
        squares = np.square(self.semi_axes)
        volume = 4.0 / 3.0 * np.pi * np.prod(self.semi_axes)
        return MassProperties(volume, np.zeros(3), volume / 5.0 * np.diag(squares.sum() - squares))


@pytest.fixture
def ellipsoids():
    """Registers the shape under this key while a test runs."""
    with taken_back():
        register_shape("ellipsoid", Ellipsoid)
        yield


@builder
def pressed(write_block, tmp_path, /, shape, depth=0.002):
    """Force [N] of a shape of a height of 40 mm, pressed into a soft block from a scene file."""
    mapping = {
        "name": "pressed", "gravity": [0.0, 0.0, 0.0],
        "body": {"name": "block", "mesh": {"file": write_block((SIZE, SIZE, 0.02), (6, 6, 3), shake=0.1)},
                 "material": MATERIAL,
                 "fixed": [{"box": {"minimum": [-1, -1, -1], "maximum": [1, 1, -0.009999]}}]},
        "rigid_bodies": [{"name": "tool", "motion": "guided", "position": [0.001, 0.002, 0.031], **shape}],
        "contact": {"alarm_distance": 0.003, "between": [{"pair": ["block", "tool"]}]},
    }  # fmt: skip
    (tmp_path / "pressed.yaml").write_text(yaml.safe_dump(mapping))
    simulation = Simulation(load_scene(tmp_path / "pressed.yaml"))
    simulation.model.guides.aim("tool", [0.001, 0.002, 0.03 - depth])
    for _ in range(12):
        result = simulation.step(Hold(1.0))
    return -result.contacts.forces.sum(axis=0)


def test_a_scene_names_a_shape_only_while_it_is_registered(pressed):
    assert "ellipsoid of semi-axes [20, 20, 20] mm" == Ellipsoid(semi_axes=ROUND).describe()
    with taken_back():
        register_shape("ellipsoid", Ellipsoid)
        with pytest.raises(ValueError, match="have a key ellipsoid already"):
            register_shape("ellipsoid", Ellipsoid)
        with pytest.raises(SceneError, match="semi_axes.*must be above 0"):
            pressed({"ellipsoid": {"semi_axes": [0.0, 0.02, 0.02]}})
    with pytest.raises(SceneError, match="ellipsoid.*is not a key here"):
        pressed({"ellipsoid": {"semi_axes": list(ROUND)}})


def test_its_distance_and_its_gradient_are_those_of_its_surface(drawn_rng):
    shape = Ellipsoid(centre=(0.1, -0.2, 0.3), semi_axes=(0.3, 0.2, 0.1))
    points = shape.centre + drawn_rng.uniform(-0.4, 0.4, (200, 3))
    distances, gradients = shape.signed_distances(points)
    np.testing.assert_allclose(np.linalg.norm(gradients, axis=1), 1.0)
    feet = (points - distances[:, None] * gradients - shape.centre) / shape.semi_axes
    np.testing.assert_allclose(np.square(feet).sum(axis=1), 1.0, rtol=1e-9)
    normals = feet / shape.semi_axes
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    np.testing.assert_allclose(normals, gradients, atol=1e-9)
    assert (distances < 0.0).any() and (distances > 0.0).any()


def test_a_round_one_presses_a_soft_body_as_a_sphere_does(ellipsoids, pressed):
    sphere = pressed({"sphere": {"radius": 0.02}})
    assert sphere[2] > 0.1
    np.testing.assert_allclose(pressed({"ellipsoid": {"semi_axes": list(ROUND)}}), sphere, rtol=0.02, atol=2e-3)


def test_a_flat_one_presses_harder_than_a_sphere_and_a_sharp_one_less(ellipsoids, pressed):
    # By Hertz as the root of the radius of curvature at its tip, a²/c.
    flat, tall = (pressed({"ellipsoid": {"semi_axes": [a, a, 0.02]}})[2] for a in (0.028, 0.014))
    assert 1.5 < flat / tall < 2.5


@pytest.mark.parametrize("pair", [("floor", "egg"), ("egg", "slab")])
def test_a_free_one_comes_to_rest_on_a_floor_and_a_slab_with_its_weight(ellipsoids, scene_of, pair):
    simulation = scene_of(
        gravity=[0.0, 0.0, -9.81], integration="dynamic",
        rigid_bodies=[{"name": "egg", "mass": 0.05, "position": [0.0, 0.0, 0.01],
                       "ellipsoid": {"semi_axes": [0.03, 0.02, 0.01]}, "damping": 5.0}],
        obstacles=[{"name": "floor", "plane": {}},
                   {"name": "slab", "box": {"size": [0.2, 0.2, 0.1]}, "position": [0.0, 0.0, -0.05]}],
        contact={"friction": 0.5, "between": [{"pair": list(pair)}]},
    )  # fmt: skip
    for _ in range(100):
        result = simulation.step(Hold(STEP))
        assert result.status.is_success
    height = result.state.positions[0, 2]
    assert height == pytest.approx(0.01, abs=1e-6 if "floor" in pair else 3e-4)
    assert abs(result.contacts.forces.sum(axis=0)[2]) == pytest.approx(0.05 * 9.81, rel=1e-2)


@pytest.mark.exhaustive
def test_a_ball_and_a_beam_touch_it_where_they_touch_a_sphere(ellipsoids, scene_of):
    def gaps(shape):
        simulation = scene_of(
            gravity=[0.0, 0.0, 0.0], integration="dynamic",
            rigid_bodies=[{"name": "ball", "mass": 0.01, "position": [0.0, 0.031, 0.0],
                           "sphere": {"radius": 0.01}}],
            beams=[{"name": "rod", "points": [[-0.05, 0.0, 0.0225], [0.05, 0.0, 0.0225]],
                    "section": {"circle": {"radius": 0.002}}, "elements": 3,
                    "material": {"young_modulus": 1e9, "poisson_ratio": 0.3, "density": 1000.0}}],
            obstacles=[{"name": "knob", **shape}],
            contact={"alarm_distance": 0.005,
                     "between": [{"pair": ["ball", "knob"]}, {"pair": ["rod", "knob"]}]},
        )  # fmt: skip
        contacts = simulation.model.contacts
        contacts.detect(simulation.model.nodes.rest_positions)
        return contacts.found.gaps[: contacts.count].copy()

    sphere = gaps({"sphere": {"radius": 0.02}})
    np.testing.assert_allclose(sphere, [0.001, 0.0005], atol=1e-6)
    np.testing.assert_allclose(gaps({"ellipsoid": {"semi_axes": list(ROUND)}}), sphere, atol=1e-7)
