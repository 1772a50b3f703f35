"""What converters can carry: the closed form against its own equations, and what follows from the paper's values."""

import cmath
import dataclasses
import math

import numpy as np
import pytest

import shipgrid as sg
from shipgrid.components.electrical.lcl_filter import LclFilter
from shipgrid.controllers.rectifier_control import RectifierControl, d_headroom, q_headroom
from shipgrid.equipment.capability import (
    FilterAtRest,
    RectifierLimits,
    active_current,
    inverter_end,
    inverter_on,
    largest,
    node_voltage,
    voltage_limit,
)
from shipgrid.equipment.filter_rules import inductance_for_ripple, resonance_band, ripple_of
from shipgrid.equipment.inverter import Inverter
from shipgrid.equipment.rectifier import DESIGN_RULES, L_1_PRESETS, Rectifier
from shipgrid.equipment.ship import ShipInNetwork
from shipgrid.errors import ParameterError
from shipgrid.model.network import Network
from shipgrid.model.records import parameter_record

SIDES = (480.0, 60.0, 750.0)


def item(preset="paper", **more):
    return Rectifier(source="genset", bus="dc", lcl_preset=preset, **more)


def ferry(**rectifier):
    """The ferry, its rectifiers changed, as its items see it."""
    changes = [(f"equipment.rectifier_{side}.{k}", v) for k, v in rectifier.items() for side in ("for", "aft")]
    ship = sg.load_ship("ferry", changes)
    network = Network(ship.name)
    ship.build(network)
    return network, ShipInNetwork(ship, network)


# the closed form


def test_voltage_limit_at_nominal_dc_voltage_is_1_105_pu():
    assert voltage_limit(750.0, 480.0) == pytest.approx(750.0 / math.sqrt(3.0) / (480.0 * math.sqrt(2.0 / 3.0)))
    assert voltage_limit(750.0, 480.0) == pytest.approx(1.105, abs=5e-4)  # printed to three digits
    assert voltage_limit(750.0, 480.0, m_max=0.866) == pytest.approx(0.957, abs=5e-4)


def test_without_reactive_current_the_paper_s_choke_passes_0_36_pu_and_with_it_at_most_0_857():
    v_lim = voltage_limit(750.0, 480.0)
    assert active_current(v_lim, 1.0, 1.29) == pytest.approx(0.36, abs=5e-3)  # printed to two digits
    assert active_current(v_lim, 1.0, 1.29, -1.0 / 1.29) == pytest.approx(0.857, abs=1e-3)  # 1.105 / 1.29
    assert active_current(1.0, 1.05, 1.29) == 0.0  # not even without active power


@pytest.mark.parametrize("preset", [*L_1_PRESETS, DESIGN_RULES])
@pytest.mark.parametrize("v_dc", [640.0, 712.5, 750.0])
def test_a_point_satisfies_the_filter_s_phasor_equations(preset, v_dc):
    limits = item(preset).limits(v_dc, *SIDES)
    Z_1, Z_2, Y = limits.lcl
    end = limits.end
    bridge = end.v_node - Z_1 * end.i
    side = end.v_node + Z_2 * (end.i + Y * end.v_node)
    assert abs(side) == pytest.approx(1.0, abs=1e-9)
    assert end.v == pytest.approx(bridge)
    assert end.p_dc == pytest.approx((bridge * end.i.conjugate()).real)
    taken = side * (end.i + Y * end.v_node).conjugate()
    lost = Z_1.real * abs(end.i) ** 2 + Z_2.real * abs(end.i + Y * end.v_node) ** 2 + end.v_node**2 * Y.real
    assert taken.real == pytest.approx(end.p_dc + lost)
    assert (end.q_ac, end.s_ac) == pytest.approx((taken.imag, abs(taken)))
    assert abs(end.i) <= 1.2 + 1e-8
    # the control's limits count the choke's reactance alone
    assert abs(end.v_node - 1j * Z_1.imag * end.i) <= limits.v_lim + 1e-8


@pytest.mark.parametrize("preset", [*L_1_PRESETS, DESIGN_RULES])
@pytest.mark.parametrize("v_dc", [640.0, 712.5, 750.0])
def test_the_end_is_that_of_the_control_s_own_limits(preset, v_dc):
    limits = item(preset).limits(v_dc, *SIDES)
    end, p = limits.end, parameter_record(item(preset).fitted_control(*SIDES))[0]
    v_lim = voltage_limit(v_dc, 480.0)
    assert d_headroom(end.v_node, v_lim, p) == pytest.approx(end.i.real, rel=1e-6)
    assert min(q_headroom(end.i.real, end.v_node, v_lim, p), 0.0) == pytest.approx(end.i.imag, abs=1e-6)


def test_more_is_carried_with_more_dc_voltage_and_with_a_smaller_choke():
    powers = [item().limits(v_dc, *SIDES).end.p_dc for v_dc in (600.0, 650.0, 712.5, 750.0, 800.0)]
    assert powers == sorted(powers)
    powers = [item("custom", L_1=L_1).limits(712.5, *SIDES).end.p_dc for L_1 in (1.29, 0.742, 0.5, 0.371, 0.2)]
    assert powers == sorted(powers)


def test_a_weak_ac_side_ends_the_power_itself():
    lcl = FilterAtRest(Z_1=0.1j, Z_2=0.9j, Y=0.05j)
    limits = RectifierLimits(lcl, v_lim=1.5, share=0.99, i_max=3.0)
    end = limits.end
    assert end.ended_by == "source"
    assert limits.at(end.i.real + 1e-6) is None
    assert node_voltage(lcl, 0j, complex(1.2 / 0.9), 1.0) is None


def test_a_dc_voltage_too_low_for_any_current_is_refused():
    with pytest.raises(ParameterError, match=r"carries nothing at an AC voltage of 1 pu"):
        _ = RectifierLimits(FilterAtRest.of(item().lcl(*SIDES), 596e3, 480.0, 60.0), 0.1, 0.8, 0.3).end


def test_the_end_of_a_condition_is_found():
    assert largest(lambda x: x * x <= 2.0, 0.0, 10.0) == pytest.approx(math.sqrt(2.0), abs=1e-8)
    assert largest(lambda x: True, 0.0, 3.0) == 3.0
    assert largest(lambda x: False, 0.5, 3.0) == 0.5


def test_an_inverter_at_its_end_stands_at_its_voltage_limit():
    lcl = FilterAtRest.of(LclFilter.per_unit(50e3, 400.0, 60.0, 0.891, 0.06, 0.10), 50e3, 400.0, 60.0)
    v_lim = voltage_limit(750.0, 400.0)
    end = inverter_end(lcl, v_lim, 1.25, 0.02, 0.9)
    assert abs(end.v) == pytest.approx(v_lim, rel=1e-7)
    assert end.ended_by == "voltage"
    load = end.v_bar**2 / end.s * cmath.rect(1.0, math.acos(0.9))
    again = inverter_on(lcl, load, 0.02)
    assert again.s == pytest.approx(end.s, rel=1e-6)
    # the droop: V = 1 - m_q q where the chokes meet
    i_g = end.v_bar / abs(load)
    q = (load + lcl.Z_2).imag * i_g**2
    assert i_g * abs(load + lcl.Z_2) == pytest.approx(1.0 - 0.02 * q, rel=1e-6)
    assert inverter_end(lcl, 3.0, 1.25, 0.02, 1.0).ended_by == "current"


# rules of design


@pytest.mark.parametrize("modulation", [0.5, 0.7, 0.9, 1.0])
def test_ripple_rule_is_that_of_pulses_with_min_max_injection(modulation):
    """Largest peak to peak of a carrier period, over all angles, of the volt-seconds of three legs on a star."""
    n = 4000
    carrier = np.abs((2.0 * (np.arange(n) + 0.5) / n) % 2.0 - 1.0)
    widest = 0.0
    for angle in np.linspace(0.0, 2.0 * math.pi, 121):
        v = modulation / math.sqrt(3.0) * np.cos(angle - 2.0 * math.pi / 3.0 * np.arange(3))
        duty = 0.5 + v - 0.5 * (v.max() + v.min())
        s = (carrier[:, None] < duty).astype(float)
        u = s - s.mean(axis=1, keepdims=True)  # an insulated star
        current = np.cumsum(u - u.mean(axis=0), axis=0) / n  # of v_dc / (f_sw L)
        widest = max(widest, np.ptp(current, axis=0).max())
    assert widest == pytest.approx(ripple_of(1.0, 1.0, 1.0, modulation), rel=2e-3)  # 4000 instants a period


def test_the_sizing_rule_gives_back_its_ripple():
    L_1 = inductance_for_ripple(0.2, 750.0, 1620.0, 596e3, 480.0)
    assert ripple_of(L_1, 750.0, 1620.0) == pytest.approx(0.2 * 596e3 * math.sqrt(2.0 / 3.0) / 480.0)
    by_tenth = inductance_for_ripple(0.1, 750.0, 1620.0, 596e3, 480.0) * 2.0 * math.pi * 60.0 * 596e3 / 480.0**2
    assert by_tenth == pytest.approx(L_1_PRESETS["phase_voltage_rule"], abs=5e-4)


def test_preset_by_rules_has_a_fifth_of_ripple_and_a_twentieth_of_reactive_power():
    L_1, C = item(DESIGN_RULES).per_unit_filter(*SIDES)
    assert pytest.approx(0.371, abs=5e-4) == L_1
    assert C == 0.05
    L_1_half, _ = item(DESIGN_RULES, ripple=0.1).per_unit_filter(*SIDES)
    assert L_1_half == pytest.approx(2.0 * L_1)
    lcl, control = item(DESIGN_RULES).lcl(*SIDES), item(DESIGN_RULES).fitted_control(*SIDES)
    assert (control.L_1, control.R_d) == (lcl.L_1, lcl.R_d)
    assert (control.K_p, control.K_i) == pytest.approx((L_1 / 1.29, 7.0 * L_1 / 1.29))


def test_paper_stays_the_default_with_its_own_values():
    assert item().per_unit_filter(*SIDES) == (1.29, 0.07)
    assert item().fitted_control(*SIDES).K_p == RectifierControl().K_p


def test_a_value_that_the_preset_would_pass_over_is_refused():
    with pytest.raises(ParameterError, match=r"rectifier\.L_1 = 0\.4 is set by lcl_preset: paper"):
        item(L_1=0.4)
    with pytest.raises(ParameterError, match=r"rectifier\.C = 0\.06 is set by lcl_preset: design_rules"):
        item(DESIGN_RULES, C=0.06)
    with pytest.raises(
        ParameterError, match=r"rectifier\.ripple = 0\.3 is read only with that, expected lcl_preset: design_rules"
    ):
        item(ripple=0.3)
    assert item("custom", L_1=0.4, C=0.06).per_unit_filter(*SIDES) == (0.4, 0.06)
    assert item(C=0.06).per_unit_filter(*SIDES) == (1.29, 0.06)


def test_resonance_behind_the_generator_is_below_ten_times_the_frequency_with_the_paper_s_filter_only():
    low, high = resonance_band(60.0, 1620.0)
    assert (low, high) == (600.0, 810.0)
    network, ship = ferry()
    behind, stiff = ship.item("rectifier_for").resonances(network, ship)
    assert (behind.frequency, stiff.frequency) == pytest.approx((518.1, 781.9), abs=0.1)
    assert (behind.placed, stiff.placed) == ("below", "inside")
    network, ship = ferry(lcl_preset=DESIGN_RULES)
    behind, stiff = ship.item("rectifier_for").resonances(network, ship)
    assert (behind.frequency, stiff.frequency) == pytest.approx((717.0, 997.0), abs=0.1)
    assert (behind.placed, stiff.placed) == ("inside", "above")


# set beside the ratings


def test_ferry_s_rectifiers_carry_three_fifths_of_their_rating_and_by_the_rules_all_of_it():
    network, ship = ferry()
    (row,) = ship.item("rectifier_for").rated(network, ship)
    assert [v_dc for v_dc, _, _ in row.carries] == [750.0, 712.5]
    assert [power for _, power, _ in row.carries] == pytest.approx([377.5e3, 358.0e3], rel=1e-3)
    assert row.short and "design_rules" in row.remedy and "0.755 pu" in row.remedy
    network, ship = ferry(lcl_preset=DESIGN_RULES)
    (row,) = ship.item("rectifier_for").rated(network, ship)
    assert not row.short and row.remedy == ""


def test_the_largest_choke_that_is_named_carries_the_rating_and_a_larger_one_does_not():
    for L_1, carries in ((0.755, True), (0.757, False)):
        end = item("custom", L_1=L_1).limits(712.5, *SIDES).end
        assert (end.p_dc >= 1.0) == carries


def test_a_rectifier_whose_dc_voltage_is_too_low_for_any_filter_says_so():
    network, ship = ferry()
    low = dataclasses.replace(ship.item("rectifier_for"), dc_droop=0.3)
    (row,) = low.rated(network, ship)
    assert row.short and "no smaller one carries the rating" in row.remedy


def test_ferry_s_inverters_carry_less_than_their_rating_of_the_hotel_s_power_factor():
    network, ship = ferry()
    unity, hotel = ship.item("inverter_for").rated(network, ship)
    assert (unity.under, hotel.under) == ("power factor 1", "power factor 0.9")
    assert [v_dc for v_dc, _, _ in hotel.carries] == [750.0, 712.5]
    assert [s for _, s, _ in unity.carries] == pytest.approx([46.6e3, 41.7e3], rel=2e-3)
    assert [s for _, s, _ in hotel.carries] == pytest.approx([31.2e3, 26.9e3], rel=2e-3)
    assert hotel.short and "0.416 pu" in hotel.remedy
    # what the design says of the paper's choke: 20 kW at power factor 0.9 are out of reach
    paper = Inverter(bus="dc_for", grid="ac_for", filter="paper").resolved()
    assert paper.end(750.0, 400.0, 60.0, 0.9).s * 50e3 * 0.9 < 20e3
