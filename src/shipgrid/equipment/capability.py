"""What a two-level bridge behind an LCL filter can carry: the limit of its voltage, in closed form.

At rest, as phasors per unit of the converter's rating, with the d axis on the voltage V at the node where the chokes
meet, and the current i of the converter-side choke into the bridge (i_d > 0 power into the DC bus, i_q > 0 reactive
power delivered):

    v = V - Z_1 i,    |v| <= v_lim = m_max v_dc / (sqrt 3 V_b)                                      (1)

With Z_1 = j X_1 a disc of the current plane, of radius v_lim / X_1 around i_q = -V / X_1: reactive current taken from
the AC side lets more power through,

    i_d = sqrt(v_lim^2 - (V + X_1 i_q)^2) / X_1                                                     (2)

At the AC side stands a voltage of length e behind Z_2; Y is the filter's capacitor with its damping resistor:

    |V + Z_2 (i + Y V)| = e                                                                         (3)

Given i = a V + b, (3) is a quadratic equation of V alone: a = 0 where the current is given, and on the edge of the disc
a = -j / X_1. Resistances count in (3) and in the power p_dc = Re(v i*), not in the control's own limits, which have X_1
alone.

Derivation: docs/theory/converters.md, eqs. (converters-5) to (converters-11).
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable
from typing import Any, NamedTuple

from shipgrid.components.electrical.lcl_filter import LclFilter
from shipgrid.errors import ParameterError

SMALLEST_CHOKE = 1e-3
"""Converter-side inductance [pu] below which none is looked for that carries a rating."""
ENDS = {"voltage": "the voltage of its bridge", "current": "its current limit", "source": "the AC side"}
"""What ends the power of a converter, in words."""
NARROWEST = 1e-9
"""Width [pu] to which an end that has no closed form is found."""


class FilterAtRest(NamedTuple):
    """An LCL filter at its nominal frequency, per unit: both chokes' impedances, the capacitor branch's admittance."""

    Z_1: complex
    Z_2: complex
    Y: complex

    @classmethod
    def of(cls, lcl: LclFilter, rating: float, v_n: float, f_n: float) -> FilterAtRest:
        """The filter on its converter's rating.

        Parameters
        ----------
        lcl : LclFilter
            The filter, SI.
        rating : float
            Base power [VA].
        v_n : float
            Base voltage, line to line, rms [V].
        f_n : float
            Base frequency [Hz].
        """
        z, omega = v_n**2 / rating, 2.0 * math.pi * f_n
        Z_1, Z_2 = complex(lcl.R_1, omega * lcl.L_1) / z, complex(lcl.R_2, omega * lcl.L_2) / z
        return cls(Z_1, Z_2, z / complex(lcl.R_d, -1.0 / (omega * lcl.C)))


class Carried(NamedTuple):
    """An operating point of a rectifier at rest, per unit of its rating, and what ends its power there.

    Attributes
    ----------
    p_dc : float
        Power into the DC bus [pu].
    i : complex
        Current into the bridge [pu], i_d + j i_q.
    v_node : float
        Voltage where the chokes meet [pu].
    v : complex
        Voltage of the bridge [pu].
    q_ac : float
        Reactive power taken from the AC side, filter included [pu].
    s_ac : float
        Apparent power taken from the AC side [pu].
    ended_by : str
        One of `ENDS`; empty for a point that is no end.
    """

    p_dc: float
    i: complex
    v_node: float
    v: complex
    q_ac: float
    s_ac: float
    ended_by: str = ""


def voltage_limit(v_dc: float, v_n: float, m_max: float = 1.0) -> float:
    """Longest voltage vector of a bridge, per unit of the peak phase voltage: (1).

    Parameters
    ----------
    v_dc : float
        DC voltage [V].
    v_n : float
        Nominal AC voltage, line to line, rms [V].
    m_max : float
        Over v_dc / sqrt 3: 1 with min-max injection, 0.866 without.
    """
    return m_max * v_dc / (math.sqrt(2.0) * v_n)


def active_current(v_lim: float, v_node: float, X_1: float, i_q: float = 0.0) -> float:
    """Largest active current [pu] at a voltage limit: (2); 0 where even none would need more voltage.

    Parameters
    ----------
    v_lim : float
        Longest voltage of the bridge [pu].
    v_node : float
        Voltage where the chokes meet [pu].
    X_1 : float
        Reactance of the converter-side choke [pu].
    i_q : float
        Reactive current [pu], positive delivered to the AC side; at -v_node / X_1 the most is carried.
    """
    room = v_lim**2 - (v_node + X_1 * i_q) ** 2
    return math.sqrt(room) / X_1 if room > 0.0 else 0.0


def node_voltage(lcl: FilterAtRest, a: complex, b: complex, e: float) -> float | None:
    """Voltage [pu] where the chokes meet, for a current i = a V + b: (3), the upper solution; None if there is none.

    Parameters
    ----------
    lcl : FilterAtRest
        The filter.
    a : complex
        Current per node voltage [pu].
    b : complex
        Current beside that [pu].
    e : float
        Voltage of the AC side [pu].
    """
    a, b = 1.0 + lcl.Z_2 * (lcl.Y + a), lcl.Z_2 * b
    half = (a.conjugate() * b).real
    square = half**2 - abs(a) ** 2 * (abs(b) ** 2 - e**2)
    return (math.sqrt(square) - half) / abs(a) ** 2 if square >= 0.0 else None


class RectifierLimits(NamedTuple):
    """What bounds the current references of an active rectifier: its control's limits (3) to (6).

    Attributes
    ----------
    lcl : FilterAtRest
        The filter.
    v_lim : float
        Voltage that references may use [pu]: the margin for control taken off.
    share : float
        Share of it that the d-axis current may use across the choke.
    i_max : float
        Largest length of the current reference [pu].
    e : float
        Voltage of the AC side [pu], held by its regulator.
    """

    lcl: FilterAtRest
    v_lim: float
    share: float
    i_max: float
    e: float = 1.0

    def at(self, i_d: float) -> Carried | None:
        """The point with the active current `i_d` [pu] and just the reactive current that the voltage limit asks for.

        None where the AC side cannot feed that current, or the voltage does not reach for it.
        """
        X = self.lcl.Z_1.imag
        square = self.v_lim**2 - (X * i_d) ** 2
        if square < 0.0:
            return None
        v_node = node_voltage(self.lcl, -1j / X, i_d + 1j * math.sqrt(square) / X, self.e)  # on the edge of the disc
        i_q = 0.0 if v_node is None else (math.sqrt(square) - v_node) / X
        if v_node is None or i_q > 0.0:  # no reactive current is needed
            i_q, v_node = 0.0, node_voltage(self.lcl, 0j, complex(i_d), self.e)
        if v_node is None:
            return None
        i = complex(i_d, i_q)
        v, i_ac = v_node - self.lcl.Z_1 * i, i + self.lcl.Y * v_node
        s_ac = (v_node + self.lcl.Z_2 * i_ac) * i_ac.conjugate()
        return Carried((v * i.conjugate()).real, i, v_node, v, s_ac.imag, abs(s_ac))

    @property
    def end(self) -> Carried:
        """The most it carries: by its share of the voltage in closed form, else where voltage and current limit meet.

        Raises
        ------
        ParameterError
            If it carries nothing at all: the voltage is too low for it.
        """
        by_voltage = self.share * self.v_lim / self.lcl.Z_1.imag
        most = min(by_voltage, self.i_max)
        point = self.at(most)
        if point is not None and abs(point.i) <= self.i_max:
            return point._replace(ended_by="voltage" if by_voltage <= self.i_max else "current")

        def allowed(i_d: float) -> bool:
            found = self.at(i_d)
            return found is not None and abs(found.i) <= self.i_max

        if not allowed(0.0):
            raise ParameterError(
                f"a rectifier with {self.v_lim:g} pu of voltage and {self.i_max:g} pu of current carries nothing at an "
                f"AC voltage of {self.e:g} pu"
            )
        i_d = largest(allowed, 0.0, most)
        found = self.at(i_d)
        assert found is not None
        return found._replace(ended_by="current" if self.at(i_d + 2.0 * NARROWEST) is not None else "source")


class LoadedInverter(NamedTuple):
    """A grid-forming inverter on a load impedance at rest, per unit of its rating.

    Attributes
    ----------
    s : float
        Apparent power of the load [pu].
    v_bar : float
        Voltage of its bar [pu].
    i : complex
        Current out of the bridge [pu], d axis on the node voltage.
    v : complex
        Voltage of the bridge [pu].
    ended_by : str
        One of `ENDS`; empty for a point that is no end.
    """

    s: float
    v_bar: float
    i: complex
    v: complex
    ended_by: str = ""


def inverter_on(lcl: FilterAtRest, load: complex, m_q: float, v_set: float = 1.0) -> LoadedInverter:
    """Operating point of a grid-forming inverter on a load impedance, its voltage droop in force.

    The control holds V = V* - m_q q where the chokes meet; with the admittance y of all that is behind, q = -V^2 Im y.

    Parameters
    ----------
    lcl : FilterAtRest
        The filter, its second choke the transformer.
    load : complex
        Impedance of the load [pu].
    m_q : float
        Droop of the voltage [pu].
    v_set : float
        Set point V* of the voltage [pu].
    """
    y = 1.0 / (lcl.Z_2 + load)
    k = -m_q * y.imag
    v_node = v_set if k == 0.0 else (math.sqrt(1.0 + 4.0 * k * v_set) - 1.0) / (2.0 * k)
    i_g = y * v_node
    i = i_g + lcl.Y * v_node
    return LoadedInverter(abs(load) * abs(i_g) ** 2, abs(load * i_g), i, v_node + lcl.Z_1 * i)


def inverter_end(lcl: FilterAtRest, v_lim: float, i_max: float, m_q: float, power_factor: float) -> LoadedInverter:
    """The most a grid-forming inverter carries of a lagging load: until the voltage or the current reaches its limit.

    The load prescribes the reactive current, so (1) has no closed solution with the droop; it is found by bisection.
    The threshold virtual impedance, which lowers the voltage above the rated current, is left out.

    Parameters
    ----------
    lcl : FilterAtRest
        The filter.
    v_lim : float
        Longest voltage of the bridge [pu].
    i_max : float
        Longest current of the bridge [pu].
    m_q : float
        Droop of the voltage [pu].
    power_factor : float
        cos phi of the load, lagging.
    """
    direction = cmath.rect(1.0, math.acos(power_factor))

    def allowed(admittance: float) -> bool:
        point = inverter_on(lcl, direction / max(admittance, NARROWEST), m_q)
        return abs(point.v) <= v_lim and abs(point.i) <= i_max

    admittance = largest(allowed, 0.0, 2.0 * i_max)
    point = inverter_on(lcl, direction / max(admittance, NARROWEST), m_q)
    return point._replace(ended_by="current" if abs(point.i) >= i_max * (1.0 - 1e-6) else "voltage")


def largest(allowed: Callable[[float], bool], low: float, high: float) -> float:
    """Largest value between `low` and `high` up to which a condition holds, to `NARROWEST`; `low` if it never does.

    Parameters
    ----------
    allowed : callable
        The condition, which holds up to somewhere.
    low, high : float
        Range.
    """
    if allowed(high):
        return high
    while high - low > NARROWEST:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if allowed(middle) else (low, middle)
    return low


def largest_choke(enough: Callable[[float], bool], L_1: float) -> float | None:
    """Largest converter-side inductance [pu] below `L_1` that carries a rating, rounded down; None if there is none.

    A very small one may not do where a larger one does: against a low DC voltage it takes more reactive current.

    Parameters
    ----------
    enough : callable
        Whether the rating is carried with an inductance [pu].
    L_1 : float
        One that does not do [pu].
    """
    high = L_1
    while high > SMALLEST_CHOKE:
        low = 0.97 * high
        if enough(low):
            return math.floor(1e3 * largest(enough, low, high)) / 1e3
        high = low
    return None


def lowest_full_load_voltage(ship: Any, bus: str) -> float:
    """DC voltage [V] of a bus when its source of the steepest droop gives its rated current; nominal without any.

    Parameters
    ----------
    ship : ShipInNetwork
        What an item sees of its ship.
    bus : str
        Name of the DC bus.
    """
    v_n = ship.bus(bus).v_n
    feeding = [s for s in ship.equipment.values() if hasattr(s, "full_load_voltage") and s.bus == bus]
    return min((source.full_load_voltage(v_n) for source in feeding), default=v_n)


class Rated(NamedTuple):
    """What a converter can carry, set beside its rating, as `shipgrid explain` shows it.

    Attributes
    ----------
    rating : float
        Its rating.
    unit : str
        Of the rating and of all powers here: `W`, or `VA`.
    under : str
        What else it depends on, as `power factor 0.9`.
    carries : tuple of (float, float, str)
        DC voltage [V], what it carries there, and in words what goes with it.
    remedy : str
        What would let it carry its rating, where it does not.
    """

    rating: float
    unit: str
    under: str
    carries: tuple[tuple[float, float, str], ...]
    remedy: str = ""

    @property
    def short(self) -> bool:
        """Whether it carries less than its rating at one of the voltages."""
        return any(power < self.rating * (1.0 - 1e-6) for _, power, _ in self.carries)


class Resonance(NamedTuple):
    """Resonance of a filter and where it is wanted, all in Hz; `behind` says what is counted with it."""

    frequency: float
    low: float
    high: float
    behind: str

    @property
    def placed(self) -> str:
        """`inside`, `below` or `above`."""
        if self.frequency < self.low:
            return "below"
        return "above" if self.frequency > self.high else "inside"
