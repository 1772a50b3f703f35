"""Matrices of linear elements, read off their kernels."""

from __future__ import annotations

import numpy as np
import pytest

from shipgrid.components.electrical.lcl_filter import LclFilter
from shipgrid.errors import ParameterError
from shipgrid.model import Terminal, component, kernel, param, signal
from shipgrid.model.component import type_of
from shipgrid.model.ops import absolute
from shipgrid.solvers.companion import state_space
from shipgrid.units import Ampere, Siemens, Volt


class Input:
    v: Volt = signal("voltage")


class Output:
    i: Ampere = signal("current")


@kernel
def rectified(t, u: Input, p: Rectified, y: Output):
    y.i = p.G * absolute(u.v)


@kernel
def squared(t, u: Input, p: Squared, y: Output):
    y.i = p.G * u.v**2


ENDS = (Terminal("ends", v="v", i="i"),)


@component(input=Input, output=Output, outputs=rectified, terminals=ENDS)
class Rectified:
    G: Siemens = param("conductance", default=1.0, above=0.0)


@component(input=Input, output=Output, outputs=squared, terminals=ENDS)
class Squared:
    G: Siemens = param("conductance", default=1.0, above=0.0)


@pytest.mark.parametrize("kind", [Rectified, Squared])
def test_an_element_that_is_not_linear_is_refused(kind):
    with pytest.raises(ParameterError, match=rf"{kind.__name__}: .* has to be linear"):
        state_space(kind())


def test_matrices_are_the_coefficients_of_the_equations():
    p = LclFilter(L_1=1e-3, R_1=0.1, C=20e-6, R_d=0.5, L_2=2e-3, R_2=0.2)
    space = state_space(p)
    A = [
        [-(0.1 + 0.5) / 1e-3, -1 / 1e-3, 0.5 / 1e-3],
        [1 / 20e-6, 0.0, -1 / 20e-6],
        [0.5 / 2e-3, 1 / 2e-3, -(0.5 + 0.2) / 2e-3],
    ]
    assert list(type_of(p).state.__annotations__) == ["i_1", "v_c", "i_2"]
    for row, expected in zip(space.A, A, strict=True):
        assert row == pytest.approx(expected)
    assert pytest.approx(np.array([[1 / 1e-3, 0.0], [0.0, 0.0], [0.0, -1 / 2e-3]])) == space.B
    assert pytest.approx(np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])) == space.C
