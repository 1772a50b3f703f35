"""Where a plant comes to rest: an operating point found with the equations that run it.

There is no second copy of any equation. The plant runs with its commands standing until every sequence has arrived;
then, in turn, slow continuous states are put where their own derivatives vanish (a Newton step with exact derivatives
by complex step) and the fast rest follows by running on, until a probe run shows that nothing drifts any more.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import numpy as np

from shipgrid.analysis.component_equations import ComponentKernels
from shipgrid.analysis.divergence import culprit
from shipgrid.assembly.code_store import core
from shipgrid.assembly.partition import Part
from shipgrid.assembly.plan import Plan
from shipgrid.assembly.start import evaluate_outputs, settle_outputs
from shipgrid.assembly.tables import arguments
from shipgrid.assembly.workspace import Workspace, new_workspace
from shipgrid.errors import SteadyStateError
from shipgrid.model.component import fields_of
from shipgrid.model.connections import DcBus


def advance(plan: Plan, work: Workspace, seconds: float) -> None:
    """Run on by some seconds, recording nothing; many short times are faster with `advancing`.

    Parameters
    ----------
    plan : Plan
    work : Workspace
        Goes on.
    seconds : float
        How far [s].

    Raises
    ------
    SteadyStateError
        If the run diverges.
    """
    advancing(plan, work)(seconds)


def advancing(plan: Plan, work: Workspace) -> Callable[[float], None]:
    """`advance` of a plant, as a function of the seconds alone.

    Parameters
    ----------
    plan : Plan
    work : Workspace
        Goes on with every call.
    """
    entry, values = core(), arguments(plan, work)

    def advance(seconds: float) -> None:
        left = round(seconds / plan.h)
        while left > 0:
            n = min(left, 64 * min(plan.step.record_every, plan.step.slow_every))
            done = entry(n, work.n, *values)
            work.n += abs(done)
            if done < 0:
                raise SteadyStateError(f"no operating point: the run towards it {culprit(plan, work)}")
            work.step.rows[:] = 0
            work.step.event_count[0] = 0
            left -= n

    return advance


def continuous_newton(plan: Plan, work: Workspace) -> None:
    """Put every continuous state where its component's own derivatives vanish, the inputs as they are.

    Parameters
    ----------
    plan : Plan
    work : Workspace
        Its states are moved.
    """
    for t in plan.layout.types:
        if "derivatives" not in t.kind.kernels or t.kind.terminals or not t.nx:
            continue
        free = [k for k, f in enumerate(fields_of(t.kind.state)) if not (f.signal.rotates or f.signal.counts)]
        for i in range(len(t.placed)):
            kernels = ComponentKernels(plan, t, i, work.step.delays)
            rate, by_state = kernels.rate_by_states(work.sig[kernels.x], work.sig[kernels.u], free)
            move = np.linalg.lstsq(by_state, -rate, rcond=1e-9)[0]
            if np.all(np.isfinite(move)):
                work.sig[kernels.x[free]] += move


def run_to_rest(
    plan: Plan, commands: Mapping[str, float], *, tolerance: float = 2e-4, longest: float = 30.0
) -> tuple[Workspace, float]:
    """Bring a plant to rest under standing commands.

    Parameters
    ----------
    plan : Plan
    commands : mapping of str to float
        Commands, by path, that stand.
    tolerance : float
        Largest drift [per second] of any state of a controller or a continuous component, relative to its size (or to
        1, if that is larger). The default lets a battery's voltage follow the charge it gives.
    longest : float
        Simulated time [s] after which the search gives up.

    Returns
    -------
    work : Workspace
        At rest, its step count and its logs at zero, everything that counts (charge, distance) at its initial value.
    drift : float
        The drift that is left.

    Raises
    ------
    SteadyStateError
        If it does not come to rest: names the signal that drifts most.
    """
    plan.refuse_parts()
    work = new_workspace(plan)
    for path, value in commands.items():
        work.sig[plan.layout.place(f"command:{path}", "start")] = value
    for bus in plan.network.buses.values():
        if isinstance(bus, DcBus):
            work.sig[plan.layout.index[bus.nodes[0]]] = bus.v_n
    settle_outputs(plan, work)
    watched = _settling(plan)
    places = np.array([k for _, k in watched], dtype=np.int64)
    pattern = _pattern(plan)
    counting = _counting(plan)
    started = work.sig[counting].copy()

    worst, name = np.inf, ""
    run_on = advancing(plan, work)
    run_on(2.0)
    while work.n * plan.h < longest:
        continuous_newton(plan, work)
        run_on(0.5)
        work.sig[counting] = started
        before = work.sig[places].copy()
        run_on(pattern)
        after = work.sig[places]
        drifts = np.abs(after - before) / np.maximum(np.abs(after), 1.0) / pattern
        worst = float(np.max(drifts, initial=0.0))  # a plant without controllers has none that drifts
        name = watched[int(np.argmax(drifts))][0] if watched else ""
        if worst < tolerance:
            break
    _count_from(plan, work, started)
    if not worst < tolerance:
        drift = f"{name} still drifts by {worst:.2g} of itself a second"
        raise SteadyStateError(f"no operating point in {longest:g} s: {drift}")
    return fresh(plan, work), worst


def _pattern(plan: Plan) -> float:
    """Time [s] after which sampling instants fall into steps in the same pattern again: probes compare like with like.

    A modulation held over a sampling period while the current turns on leaves a sawtooth in each bridge's power.
    """
    dens = [int(d) for i, d in zip(plan.step.clock_inc, plan.step.clock_den, strict=True) if i > 1]
    steps = math.lcm(*dens) if dens else 1
    return max(1, round(0.1 / (steps * plan.h))) * steps * plan.h


def _settling(plan: Plan) -> list[tuple[str, int]]:
    """Paths and places of the states that have to come to rest: those of controllers and continuous components.

    Meters are left out (they see the sawtooth), and so are network states, which turn with the grid.
    """
    found = []
    for t in plan.layout.types:
        if t.kind.terminals or t.kind.stage in ("measure", "modulate", "supervise") or not t.nx:
            continue
        for k, f in enumerate(fields_of(t.kind.state)):
            if not (f.signal.rotates or f.signal.counts):
                found += [(f"{placed.path}.{f.name}", t.x + i * t.nx + k) for i, placed in enumerate(t.placed)]
    return found


def _counting(plan: Plan) -> np.ndarray:
    """Places of the states that only count."""
    found = []
    for t in plan.layout.types:
        for k, f in enumerate(fields_of(t.kind.state) if t.nx else []):
            if f.signal.counts:
                found += [t.x + i * t.nx + k for i in range(len(t.placed))]
    return np.array(found, dtype=np.int64)


def _count_from(plan: Plan, work: Workspace, counted: np.ndarray) -> None:
    """Let what counts begin at these values, and what is read of it agree with them."""
    work.sig[_counting(plan)] = counted
    for t in plan.layout.types:
        if t.nx and any(f.signal.counts for f in fields_of(t.kind.state)):
            evaluate_outputs(plan, work, t)


def carried_over(plan: Plan, work: Workspace, to: Plan) -> Workspace:
    """The state of one plan as the start of another of the same plant: of the other fidelity, say.

    Every signal that both have is taken over by its path. What only the other has (the ripple of its modulators) it
    finds by itself within some carrier periods.

    Parameters
    ----------
    plan : Plan
    work : Workspace
        The state to carry over; left as it is.
    to : Plan
        At the same step, so that its delay lines are as long.
    """
    plan.refuse_parts()
    made = new_workspace(to)
    places = [(to.layout.index[path], k) for path, k in plan.layout.index.items() if path in to.layout.index]
    made.sig[[a for a, _ in places]] = work.sig[[b for _, b in places]]
    for part, own in zip(to.pieces, made.pieces, strict=True):
        for path, (first, length) in part.delay_lines.items():
            was = plan.delay_lines[path][0]
            own.step.delays[first : first + length] = work.step.delays[was : was + length]
    settle_outputs(to, made)
    if to.network.fidelity == plan.network.fidelity:  # where its samplers are, and what they remember, goes with it
        _carry_clocks(plan, work, to, made)
        for part, own in zip(to.pieces, made.pieces, strict=True):
            foreign = part.network.foreign if isinstance(part.network, Part) else ()
            read = places + [(part.layout.index[path], plan.layout.index[path]) for path in foreign]
            for now, then in ((own.step.previous, work.step.previous), (own.step.lead, work.step.lead)):
                now[[a for a, _ in read]] = then[[b for _, b in read]]
    return fresh(to, made)


def _carry_clocks(plan: Plan, work: Workspace, to: Plan, made: Workspace) -> None:
    """Let each clock of a plan stand where the same clock of another stands."""
    was = list(zip(plan.step.clock_inc.tolist(), plan.step.clock_den.tolist(), strict=True))
    for part, own in zip(to.pieces, made.pieces, strict=True):
        for k, clock in enumerate(zip(part.step.clock_inc.tolist(), part.step.clock_den.tolist(), strict=True)):
            own.step.clock_phase[k] = work.step.clock_phase[was.index(clock)]
            own.step.clock_ahead[k] = work.step.clock_ahead[was.index(clock)]


def fresh(plan: Plan, work: Workspace) -> Workspace:
    """The same state with the clock at zero and empty logs.

    Parameters
    ----------
    plan : Plan
    work : Workspace
        The state itself, no copy.
    """
    work.n = 0
    for of, piece in zip((*plan.parts, plan), (*work.parts, work), strict=True):
        piece.step.booked[:] = of.step.audit_every == 1
        step = piece.step
        piece.forget_notes()
        step.rows[:] = 0
        step.interval[:] = np.inf, -np.inf, 0.0
        step.energy[:] = 0.0
        step.exchanged[:] = 0.0
        step.limiter_time[:] = 0.0
        step.limiter_was[:] = 0.0
        step.event_count[0] = 0
    work.step.watched_was[:] = work.sig[plan.step.watched]
    return work
