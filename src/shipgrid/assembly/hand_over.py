"""The state of one plan as the start of another: with other parameters, at another step.

What a plant remembers is handed over by name: states, bus voltages, outputs that are held from sample to sample,
commands and constant inputs. A constant or command that the two networks declare differently is the new one's; any
other stays what it had become. Time goes on: clocks stand where they stand at that time in every run of the new plan.
"""

from __future__ import annotations

import numpy as np

from shipgrid.assembly.plan import Plan
from shipgrid.assembly.start import settle_network, settle_outputs
from shipgrid.assembly.workspace import Workspace, new_workspace
from shipgrid.errors import TopologyError
from shipgrid.model.component import parameters_of, type_of
from shipgrid.model.connections import PortBinding
from shipgrid.model.records import names_of

MOST_LINES = 12
"""Differences that are named one by one."""


def places_to_set(plan: Plan) -> dict[str, int]:
    """What an event may set, and where it lies in the flat vector: commands, and inputs that no signal feeds."""
    layout = plan.layout
    places = {}
    for placed in plan.network.placed.values():
        kind = type_of(placed.item)
        ends = {terminal.v for terminal in kind.terminals}
        for name in names_of(kind.input):
            path = f"{placed.path}.{name}"
            if name not in ends and not isinstance(placed.inputs.get(name), str):
                places[path] = layout.slots["u", path]
    return places | {command: layout.index[f"command:{command}"] for command in plan.network.commands}


def why_not_set(plan: Plan, path: str) -> str:
    """Why an event cannot set what a path names, in words: it is a parameter, or follows from a signal; else empty."""
    owner, _, name = path.rpartition(".")
    placed = plan.network.placed.get(owner)
    if placed is None:
        return ""
    if name in {parameter for parameter, *_ in parameters_of(type(placed.item))}:
        return f"{name} is a parameter, which stands during a run: assemble a new plan"
    fed = placed.inputs.get(name)
    return f"{name} is fed by '{fed}'" if isinstance(fed, str) else ""


def places_to_start(plan: Plan) -> dict[str, list[int]]:
    """What a start may give, by path, and where it lies: all that a plant remembers from one step to the next.

    Voltages of buses, states, outputs that are held from sample to sample, commands and constant inputs. Not the
    content of delay lines: `fill_delay_lines`.
    """
    layout = plan.layout
    places: dict[str, list[int]] = {path: [layout.index[path]] for path in layout.nodes}
    for piece in plan.pieces:
        places |= {path: [piece.layout.index[path]] for path in piece.layout.nodes}
        for t in piece.layout.types:
            parts = ("x", "y") if "update" in t.kind.kernels else ("x",)
            for placed in t.placed:
                for part in parts:
                    record = t.kind.state if part == "x" else t.kind.output
                    for name in names_of(record) if (t.nx if part == "x" else t.ny) else ():
                        path = f"{placed.path}.{name}"
                        if placed.path in piece.delay_lines and name == "position":
                            continue
                        places.setdefault(path, []).append(piece.layout.slots[part, path])
    return places | {path: [place] for path, place in places_to_set(plan).items()}


def remembered(work: Workspace) -> dict[str, float]:
    """Values [SI] of all that a plant remembers, by path: what `places_to_start` names."""
    return {path: float(work.sig[places[-1]]) for path, places in places_to_start(work.plan).items()}


def differences(was: Plan, now: Plan) -> list[str]:
    """What differs in the structure of two plants, a line each: buses, elements, their types and connections."""
    before, after = _structure(was), _structure(now)
    lines = []
    for path in dict.fromkeys([*before, *after]):
        if path not in after:
            lines.append(f"{path}: {before[path]} there, nothing here")
        elif path not in before:
            lines.append(f"{path}: nothing there, {after[path]} here")
        elif before[path] != after[path]:
            lines.append(f"{path}: {before[path]} there, {after[path]} here")
    return lines


def _structure(plan: Plan) -> dict[str, str]:
    network = plan.network
    found = {f"bus '{name}'": "DC" if len(bus.nodes) == 1 else "AC" for name, bus in network.buses.items()}
    for path, placed in network.placed.items():
        ends = ", ".join(f"{name} at {_end(binding)}" for name, binding in sorted(placed.ports.items()))
        found[f"'{path}'"] = f"{type_of(placed.item).name}{f' ({ends})' if ends else ''}"
    return found


def _end(binding: PortBinding) -> str:
    words = [binding.plus or "the reference", *([f"and {binding.minus}"] if binding.minus else [])]
    return " ".join(words + ([f"by {binding.coefficient}"] if binding.coefficient else []))


def handed_over(work: Workspace, to: Plan) -> Workspace:
    """A state as the start of another plan of the same structure, at the same time.

    Parameters
    ----------
    work : Workspace
        The state, left as it is.
    to : Plan
        Of a network with the same buses and elements; parameters, step, inputs and clocks may differ.

    Returns
    -------
    Workspace
        At the step of `to` that is nearest in time.

    Raises
    ------
    TopologyError
        If buses, elements or connections differ: names them.
    """
    was = work.plan
    differing = differences(was, to)
    if differing:
        more = [f"and {len(differing) - MOST_LINES} more"] if len(differing) > MOST_LINES else []
        lines = "\n".join(f"  {line}" for line in (*differing[:MOST_LINES], *more))
        raise TopologyError(
            f"the start is of another network, '{was.network.name}', than '{to.network.name}':\n{lines}\n"
            "expected the same buses and elements; what both have can be handed over by name (`plan.common(run.final)`)"
        )
    made = new_workspace(to)
    both = _in_both(was, to)
    made.sig[[new for new, _ in both]] = work.sig[[old for _, old in both]]
    declared, before = places_to_set(to), places_to_set(was)
    for path, place in declared.items():
        if path not in before or was.layout.initial[before[path]] != to.layout.initial[place]:
            made.sig[place] = to.layout.initial[place]
    set_time(to, made, work.n * was.h)
    _carry_delay_lines(work, to, made)
    _carry_legs(work, made)
    settle(to, made)
    if to.h == was.h and not work.parts:  # what samplers look back at
        for own in made.pieces:
            for now, then in ((own.step.previous, work.step.previous), (own.step.lead, work.step.lead)):
                now[[new for new, _ in both]] = then[[old for _, old in both]]
    return made


def settle(plan: Plan, work: Workspace) -> list[str]:
    """Make everything agree with what the plant remembers; what has no path for its current, a line each."""
    settle_outputs(plan, work)
    stranded = settle_network(plan, work)
    settle_outputs(plan, work)
    return stranded


def fill_delay_lines(plan: Plan, work: Workspace) -> None:
    """Let each delay line hold what goes into it, all along: a start by values does not know what went before.

    Parameters
    ----------
    plan : Plan
    work : Workspace
        Settled; changed in place.
    """
    for piece, own in zip(plan.pieces, work.pieces, strict=True):
        placed = {p.path: p for t in piece.layout.types for p in t.placed}
        for path, (first, length) in piece.delay_lines.items():
            late = list(placed[path].item.dead_times())
            if len(late) == 1:
                own.step.delays[first : first + length] = own.sig[piece.layout.slots["u", f"{path}.{late[0]}"]]


def set_time(plan: Plan, work: Workspace, time: float) -> None:
    """Let a workspace stand at the step nearest to a time [s], and all clocks where they are then.

    Parameters
    ----------
    plan : Plan
    work : Workspace
        Changed in place.
    time : float
        From 0 on [s].
    """
    work.n = round(time / plan.h)
    for piece, own in zip((*plan.parts, plan), (*work.parts, work), strict=True):
        own.n = work.n
        inc, den = piece.step.clock_inc.astype(object), piece.step.clock_den.astype(object)
        phase = np.array([(work.n * i) % d for i, d in zip(inc, den, strict=True)], dtype=np.int64)
        own.step.clock_phase[:] = phase
        struck = phase < piece.step.clock_inc  # in the step that ended there
        own.step.clock_ahead[:] = np.where(struck, 1.0 - phase / np.maximum(piece.step.clock_inc, 1), -1.0)
        own.step.booked[:] = (work.n + 1) % piece.step.audit_every == 0


def _in_both(was: Plan, to: Plan) -> list[tuple[int, int]]:
    """Places of the signals that two plans have, by name: in the new one, in the old one."""
    pairs = {to.layout.index[path]: place for path, place in was.layout.index.items() if path in to.layout.index}
    pairs |= {to.layout.slots[slot]: place for slot, place in was.layout.slots.items() if slot in to.layout.slots}
    return list(pairs.items())


def _carry_delay_lines(work: Workspace, to: Plan, made: Workspace) -> None:
    """Fill each delay line with what the same one had in it, at the same ages."""
    old = {
        path: (piece, own, *place)
        for piece, own in zip(work.plan.pieces, work.pieces, strict=True)
        for path, place in piece.delay_lines.items()
    }
    for piece, own in zip(to.pieces, made.pieces, strict=True):
        for path, (first, length) in piece.delay_lines.items():
            if path not in old:
                continue
            was, had, start, cells = old[path]
            newest = int(work.sig[was.layout.index[f"{path}.position"]]) - 1
            values = [had.step.delays[start + (newest - k) % cells] for k in range(cells)]
            spacing = _period(piece, path) / _period(was, path)
            at = int(made.sig[piece.layout.index[f"{path}.position"]]) % length
            made.sig[piece.layout.index[f"{path}.position"]] = at
            ages = spacing * np.arange(length)
            for k, value in enumerate(np.interp(ages, np.arange(cells), values)):
                own.step.delays[first + (at - 1 - k) % length] = value


def _period(plan: Plan, path: str) -> float:
    """Period [s] of the clock of a component."""
    for t in plan.layout.types:
        for k, placed in enumerate(t.placed):
            if placed.path == path:
                return float(plan.periods[plan.clock_of[t.kind.key][k]])
    raise TopologyError(f"{plan.network.name} has no component '{path}'")


def _carry_legs(work: Workspace, made: Workspace) -> None:
    """Let blocked legs remember which diodes conducted, and what their poles carried."""
    old = {
        path: (b, piece, own)
        for piece, own in zip(work.plan.pieces, work.pieces, strict=True)
        for b, path in enumerate(piece.network.legs)
    }
    for piece, own in zip(made.plan.pieces, made.pieces, strict=True):
        for b, path in enumerate(piece.network.legs):
            k, was, had = old[path]
            here = slice(int(piece.net.leg_first[b]), int(piece.net.leg_first[b + 1]))
            there = slice(int(was.net.leg_first[k]), int(was.net.leg_first[k + 1]))
            for name in ("leg_state", "leg_s"):
                getattr(own.net, name)[here] = getattr(had.net, name)[there]
            own.net.bridge_i0[b] = had.net.bridge_i0[k] if made.plan.h == work.plan.h else np.nan


WATCHING = ("recorded", "n_plant", "record_every", "audit_every", "slow_every")
"""Fields of the constants of a step that say what is recorded; the plant is the same whatever they are."""


def same_plant(work: Workspace, plan: Plan) -> bool:
    """Whether a workspace fits a plan to the bit: one of it, of a copy that records other signals, or of its equal."""
    was = work.plan
    if was.layout is plan.layout and was.net is plan.net:
        return True
    if (was.h, len(was.parts)) != (plan.h, len(plan.parts)):
        return False
    return all(_equal(old, new) for old, new in zip(was.pieces, plan.pieces, strict=True))


def _equal(was: Plan, now: Plan) -> bool:
    """Whether two plans, or parts of plans, have the same types, places, parameters and constants."""
    old, new = was.layout, now.layout
    if [t.kind for t in old.types] != [t.kind for t in new.types] or old.slots != new.slots or old.index != new.index:
        return False
    if [t.placed for t in old.types] != [t.placed for t in new.types] or was.delay_lines != now.delay_lines:
        return False
    constants = [(old.initial, new.initial)]
    constants += [(a.parameters, b.parameters) for a, b in zip(old.types, new.types, strict=True)]
    for before, after in ((was.net, now.net), (was.step, now.step)):
        constants += [(getattr(before, name), getattr(after, name)) for name in before._fields if name not in WATCHING]
    return all(np.asarray(before).tobytes() == np.asarray(after).tobytes() for before, after in constants)


def taken_over(work: Workspace, to: Plan) -> Workspace:
    """An independent copy of a state: as it is where it is one of this plan, else handed over."""
    return work.snapshot() if same_plant(work, to) else handed_over(work, to)
