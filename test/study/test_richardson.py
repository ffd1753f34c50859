import numpy as np
import pytest

from softrobot_twin.study.accuracy_study import extrapolate

SIZES = (8.0, 5.0, 3.0, 2.2)


def series(order, sizes=SIZES):
    """Values that tend to (1, -2) with one order."""
    return [np.array([1.0, -2.0]) + h**order * np.array([0.3, 0.1]) for h in sizes]


@pytest.mark.parametrize("order", [0.7, 1.0, 2.0, 3.5])
@pytest.mark.parametrize("count", [3, 4])
def test_the_limit_of_synthetic_values_is_found_exactly(order, count):
    found = extrapolate(SIZES[-count:], series(order)[-count:])
    np.testing.assert_allclose(found.value, [1.0, -2.0], atol=1e-5)
    assert found.order == pytest.approx(order, abs=1e-4)
    correction = np.linalg.norm(series(order)[-1] - np.array([1.0, -2.0]))
    assert found.uncertainty == pytest.approx(correction, rel=1e-4)


def test_scatter_of_the_values_makes_the_limit_uncertain():
    smooth = series(2.0)
    rough = [value + shift for value, shift in zip(smooth, (0.0, 1.0, -1.0, 0.0), strict=True)]
    assert extrapolate(SIZES, rough).uncertainty > extrapolate(SIZES, smooth).uncertainty


def test_diverging_values_have_an_uncertainty_of_at_least_their_last_difference():
    found = extrapolate((4.0, 2.0, 1.0), [np.array([0.0]), np.array([1.0]), np.array([5.0])])
    assert np.isnan(found.order)
    assert found.uncertainty >= 4.0


def test_two_values_give_no_order():
    found = extrapolate((2.0, 1.0), [np.array([3.0]), np.array([3.5])])
    assert np.isnan(found.order) and found.value == 3.5 and found.uncertainty == 0.5
