"""Thin walls of solid elements against Lamé, published shells, and converged solids."""

import pytest
from wall_study import PROBLEMS


def error(problem, kind, count, layers):
    """Relative error of the displacement that a problem asks for."""
    return PROBLEMS[problem].solve(kind, count, layers).found - 1.0


@pytest.mark.parametrize("kind, bar", [
    ("linear", 0.025), ("smoothed", 0.01), ("quadratic", 2e-4), ("hexahedral", 0.01),
])  # fmt: skip
@pytest.mark.parametrize("layers", [1, 2])
def test_a_cylinder_with_a_wall_of_a_tenth_grows_as_by_lame(kind, bar, layers):
    """Stretched walls are no problem of any element: the error is that of the polygon."""
    assert abs(error("cylinder", kind, 8, layers)) < bar


@pytest.mark.sampled
@pytest.mark.parametrize("kind, count, layers, bar", [
    ("smoothed", 16, 2, 0.08), ("quadratic", 8, 2, 0.045), ("hexahedral", 8, 1, 0.03),
])  # fmt: skip
def test_a_wall_of_a_tenth_of_the_radius_bends_as_a_converged_solid(kind, count, layers, bar):
    assert abs(error("thick_hemisphere", kind, count, layers)) < bar
    assert abs(error("thick_roof", kind, count, layers)) < bar


def test_linear_tetrahedra_do_not_bend_whatever_the_layers():
    assert error("thick_hemisphere", "linear", 16, 2) < -0.6


def test_cells_longer_than_the_wall_is_thick_spoil_smoothed_elements():
    """Cells of one, and of two thicknesses along the wall; hexahedra stand eight of them."""
    long, short = (error("thick_hemisphere", "smoothed", count, 1) for count in (8, 16))
    assert long < -0.4 < -0.15 < short < 0.0


@pytest.mark.parametrize("kind, count, bar", [("quadratic", 16, 0.015), ("hexahedral", 16, 0.01)])
def test_the_scordelis_lo_roof_sinks_as_published(kind, count, bar):
    assert abs(error("roof", kind, count, 1)) < bar


def test_a_pinched_hemisphere_of_a_wall_of_a_250th_needs_many_hexahedra():
    """On meshes of usual size it hardly moves."""
    found = [error("hemisphere", "hexahedral", count, 1) for count in (8, 16)]
    assert found[0] < -0.7 < found[1] < -0.2


@pytest.mark.exhaustive
@pytest.mark.parametrize("kind, bar", [("quadratic", 0.045), ("hexahedral", 0.035)])
def test_a_pinched_hemisphere_of_fine_cells_moves_as_published(kind, bar):
    assert abs(error("hemisphere", kind, 32, 1)) < bar


@pytest.mark.parametrize("problem", ["hemisphere", "roof"])
def test_smoothed_tetrahedra_are_no_elements_for_thin_shells(problem):
    assert error(problem, "smoothed", 16, 2) < -0.6
