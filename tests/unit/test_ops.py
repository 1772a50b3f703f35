"""Elementary operations: right for real numbers, for complex ones, and for what is no number."""

import math

import numpy as np
import pytest

from shipgrid.model.ops import clip, interp, maximum, minimum


@pytest.mark.parametrize("operation", [minimum, maximum])
def test_a_value_that_is_no_number_is_handed_on_from_either_side(operation):
    assert math.isnan(operation(math.nan, 1.0))
    assert math.isnan(operation(1.0, math.nan))
    assert math.isnan(operation(complex(math.nan, 0.0), 1.0 + 0.0j).real)


def test_a_limiter_holds_numbers_and_does_not_hide_what_is_none():
    assert [clip(a, -1.0, 2.0) for a in (-3.0, 0.5, 7.0, math.inf)] == [-1.0, 0.5, 2.0, 2.0]
    assert math.isnan(clip(math.nan, -1.0, 2.0))


@pytest.mark.parametrize("a", [2.0, 2.0 + 1e-40j])
def test_a_limiter_passes_the_derivative_inside_and_none_outside(a):
    assert clip(a, 0.0, 3.0) == a
    assert clip(a, 0.0, 1.0) == 1.0
    assert np.imag(clip(a, 0.0, 1.0)) == 0.0


def test_a_table_is_linear_between_its_points_and_held_outside():
    table = np.array([9.0, 1.0, 2.0, 4.0])
    found = [interp(a, table, 1, 3, 10.0, 0.5) for a in (-5.0, 10.0, 10.25, 10.75, 11.0, 50.0)]
    assert found == [1.0, 1.0, 1.5, 3.0, 4.0, 4.0]
    assert math.isnan(interp(math.nan, table, 1, 3, 10.0, 0.5))
