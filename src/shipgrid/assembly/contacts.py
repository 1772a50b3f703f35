"""What an opening contact leaves behind: the energy of the states that a position puts to zero.

The energy of a linear element is a quadratic form of its states, E = 1/2 x' S x. It is read off the element's own
`stored_energy`, one unit vector and one pair at a time, so that no element writes it down twice.
"""

from __future__ import annotations

from itertools import combinations_with_replacement

import numpy as np

from shipgrid.assembly.layout import Layout
from shipgrid.assembly.line_end import LineEnd
from shipgrid.model.component import type_of
from shipgrid.model.kernel import call_uncompiled
from shipgrid.model.placed import Placed
from shipgrid.model.records import make_record, names_of, parameter_record


def energy_of_contacts(
    layout: Layout, energy_items: list[tuple[str, str]], ends: list[LineEnd]
) -> tuple[dict[str, np.ndarray], list[tuple[str, str]]]:
    """Fields `drop_...` of `StepPlan`, and the entries that the energy audit needs on top for them.

    Parameters
    ----------
    layout : Layout
    energy_items : list of (str, str)
        Path and ledger of each entry there is; what a contact interrupts counts as a loss of its element.
    ends : list of LineEnd
        Of stub lines; what an element that is cut loses is booked at its near end.
    """
    items = list(energy_items)
    first, rows, ledgers = [], [0], []
    terms: list[tuple[int, int, float]] = []
    cut = {end.placed.path for end in ends}
    plain = [p for t in layout.types if t.kind.linear for p in t.placed if p.path not in cut]
    # in the order in which the network's contacts are numbered
    for placed, here in [(p, True) for p in plain] + [(end.placed, end.near) for end in ends]:
        if not placed.variant:
            continue
        first.append(len(rows) - 1)
        if not here:
            rows += [len(terms)] * len(placed.positions)
            ledgers.append(0)
            continue
        entry = placed.path, "losses"
        if entry not in items:
            items.append(entry)
        ledgers.append(items.index(entry))
        form = energy_form(placed)
        for held in (states or () for states in placed.positions):
            terms += [
                (layout.slots["x", f"{placed.path}.{a}"], layout.slots["x", f"{placed.path}.{b}"], s)
                for (a, b), s in form.items()
                if a in held or b in held
            ]
            rows.append(len(terms))
    fields = {
        "drop_first": np.array(first, dtype=np.int64),
        "drop_row": np.array(rows, dtype=np.int64),
        "drop_a": np.array([a for a, _, _ in terms], dtype=np.int64),
        "drop_b": np.array([b for _, b, _ in terms], dtype=np.int64),
        "drop_s": np.array([s for _, _, s in terms]),
        "drop_ledger": np.array(ledgers, dtype=np.int64),
    }
    return fields, items[len(energy_items) :]


def energy_form(placed: Placed) -> dict[tuple[str, str], float]:
    """Factor of x_a x_b in the energy of an element in its place, for each pair of states where it is not zero."""
    kind = type_of(placed.item)
    kernel = kind.kernels.get("stored_energy")
    if kernel is None:
        return {}
    states = names_of(kind.state)
    p, tables = parameter_record(placed.item)

    def energy(*ones: str) -> float:
        x = make_record(kind.state, dict.fromkeys(states, 0.0) | dict.fromkeys(ones, 1.0))
        return placed.axis_weight * float(call_uncompiled(kernel, {"x": x, "p": p, "tables": tables}))

    found = {}
    for a, b in combinations_with_replacement(states, 2):
        factor = energy(a) if a == b else energy(a, b) - energy(a) - energy(b)
        if abs(factor) > 1e-12 * (energy(a) + energy(b)):
            found[a, b] = factor
    return found
