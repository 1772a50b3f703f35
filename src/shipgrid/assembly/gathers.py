"""Where the inputs of components come from: lists of places in the flat vector, to and from."""

from __future__ import annotations

from typing import Any

import numpy as np

from shipgrid.assembly.clocks import Clocks
from shipgrid.assembly.layout import ZERO, Layout, TypeLayout
from shipgrid.errors import TopologyError
from shipgrid.model.component import POSITION, fields_of
from shipgrid.model.placed import Placed
from shipgrid.model.records import names_of
from shipgrid.solvers.nodal import NetworkPlan


def gather_inputs(layout: Layout, t: TypeLayout) -> dict[str, np.ndarray]:
    """Lists of (to, from) for every instance: all of it, and measured network quantities apart from everything else.

    Of those first what may jump, then what is smooth, then the angles.

    Parameters
    ----------
    layout : Layout
    t : TypeLayout
        The instances of one component type.

    Returns
    -------
    dict of str to ndarray
        `now` (everything), `measured` and `latest`: rows (to, from), with the first row of each instance; and of
        `measured` the first row of each instance that is smooth, and that is an angle.

    Raises
    ------
    TopologyError
        If an input does not exist, or has to be connected and is not.
    """
    measured: list[tuple[int, int]] = []
    latest: list[tuple[int, int]] = []
    m_start, l_start, m_smooth, m_turn = [0], [0], [], []
    now: list[tuple[int, int]] = []
    n_start = [0]
    ends = {terminal.v for terminal in t.kind.terminals}
    for placed in t.placed:
        known = set(names_of(t.kind.input)) if t.nu else set()
        unknown = set(placed.inputs) - known
        if unknown:
            what = f"{placed.path} ({t.kind.name}) has no inputs {sorted(unknown)}, it has {sorted(known)}"
            raise TopologyError(what)
        for declared in fields_of(t.kind.input) if t.nu else []:
            if declared.name in ends:
                continue
            source = _source(layout, placed, declared.name, declared)
            if isinstance(source, float):
                continue
            to = layout.slots["u", f"{placed.path}.{declared.name}"]
            (measured if source in layout.network_signals else latest).append((to, source))
        own = sorted(measured[m_start[-1] :], key=lambda pair: (pair[1] in layout.angles, pair[1] in layout.smooth))
        measured[m_start[-1] :] = own
        turning = [source in layout.angles for _, source in own]
        smooth = [source in layout.smooth and source not in layout.angles for _, source in own]
        m_smooth.append(len(measured) - sum(turning) - sum(smooth))
        m_turn.append(len(measured) - sum(turning))
        m_start.append(len(measured))
        now += latest[l_start[-1] :] + own
        n_start.append(len(now))
        l_start.append(len(latest))
    return {
        "now_start": np.array(n_start, dtype=np.int64),
        "now": np.array(now, dtype=np.int64).reshape(-1, 2),
        "measured_start": np.array(m_start, dtype=np.int64),
        "measured_smooth": np.array(m_smooth, dtype=np.int64),
        "measured_turn": np.array(m_turn, dtype=np.int64),
        "measured": np.array(measured, dtype=np.int64).reshape(-1, 2),
        "latest_start": np.array(l_start, dtype=np.int64),
        "latest": np.array(latest, dtype=np.int64).reshape(-1, 2),
    }


def gather_sources(layout: Layout) -> dict[str, np.ndarray]:
    """Rows (to, from) of what the elements of the network read: their sources, and the positions of their contacts.

    Parameters
    ----------
    layout : Layout

    Raises
    ------
    TopologyError
        If an input does not exist, or has to be connected and is not.
    """
    pairs = []
    for t in layout.types:
        if not t.kind.linear:
            continue
        ends = {terminal.v for terminal in t.kind.terminals}
        for placed in t.placed:
            unknown = set(placed.inputs) - set(names_of(t.kind.input))
            if unknown:
                raise TopologyError(f"{placed.path} ({t.kind.name}) has no inputs {sorted(unknown)}")
            for declared in fields_of(t.kind.input):
                if declared.name in ends:
                    continue
                if declared.name == POSITION:
                    if placed.variant:
                        to = layout.slots["u", f"{placed.path}.{POSITION}"]
                        pairs.append((to, layout.place(placed.variant, placed.path)))
                    continue
                source = _source(layout, placed, declared.name, declared)
                if not isinstance(source, float):
                    pairs.append((layout.slots["u", f"{placed.path}.{declared.name}"], source))
    return {"latest": np.array(pairs, dtype=np.int64).reshape(-1, 2)}


def own_leads(
    layout: Layout, net: NetworkPlan, clock_of: dict[str, np.ndarray], gathers: dict[str, dict[str, np.ndarray]]
) -> None:
    """Which lead belongs to each measured signal: its own, if the bridge's modulator has the reader's clock, else none.

    A modulator gives the lead for the instants of its own clock (`conduction.lead_samples`); at a step's end there is
    none, and between the instants of two clocks the chord has to do.

    Parameters
    ----------
    layout : Layout
    net : NetworkPlan
    clock_of : dict of str to ndarray
        Number of each instance's clock, by the key of its type.
    gathers : dict of str to dict
        What `gather_inputs` gives, by the key of the type; each gets its `measured_lead`.
    """
    clock = {
        layout.index[f"{placed.path}.{name}"]: int(clock_of[t.kind.key][k])
        for t in layout.types
        if "modulate" in t.kind.kernels
        for k, placed in enumerate(t.placed)
        for name in names_of(t.kind.output)
    }
    leg_of = {int(state): int(net.leg_first[b]) for state, b in zip(net.lead_state, net.lead_bridge, strict=True)}
    leads = {state: clock.get(int(net.leg_lead[leg]), -1) for state, leg in leg_of.items()}
    for t in layout.types:
        gather = gathers.get(t.kind.key)
        if gather is None:
            continue
        start, found = gather["measured_start"], np.full(len(gather["measured"]), ZERO, dtype=np.int64)
        for k in range(len(t.placed)):
            for j in range(start[k], start[k + 1]):
                source = int(gather["measured"][j, 1])
                if leads.get(source) == clock_of[t.kind.key][k]:
                    found[j] = source
        gather["measured_lead"] = found


def looked_back_at(
    layout: Layout, gathers: dict[str, dict[str, np.ndarray]], clock_of: dict[str, np.ndarray], clocks: Clocks
) -> set[int]:
    """Places of measured quantities that are read between two steps, or carried on from the step before.

    Parameters
    ----------
    layout : Layout
    gathers : dict of str to dict
        What `gather_inputs` gives, by the key of the type.
    clock_of : dict of str to ndarray
        Number of each instance's clock, by the key of its type.
    clocks : Clocks
    """
    found = {ZERO}
    for t in layout.types:
        gather = gathers.get(t.kind.key)
        if gather is None:
            continue
        start = gather["measured_start"]
        for k in range(len(t.placed)):
            inc, den = clocks.ratios[clock_of[t.kind.key][k]]
            first = start[k] if inc not in (1, den) else gather["measured_smooth"][k]
            if inc not in (1, den) or ("derivatives" in t.kind.kernels and inc == den):
                found |= set(gather["measured"][first : start[k + 1], 1].tolist())
    return found


def _source(layout: Layout, placed: Placed, name: str, declared: Any) -> int | float:
    """Place of the signal that an input reads; of one that reads none nan, its constant being put in its place."""
    given = placed.inputs.get(name)
    path = f"{placed.path}.{name}"
    if isinstance(given, str):
        return layout.place(given, path)
    if given is not None:
        layout.initial[layout.slots["u", path]] = float(given)
    elif declared.signal.required:
        raise TopologyError(f"{path} ({declared.signal.description}) is connected to nothing")
    return float("nan")
