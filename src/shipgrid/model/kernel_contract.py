"""What a kernel is handed, what it may write and when it is called: the contract between a device and everything else.

A device declares kernels by name (`component(derivatives=..., outputs=...)`). Each asks for what it needs by the names
of its arguments, in any order; nothing else can be handed to it. docs/how-to/add_a_device.md has this table.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

ARGUMENTS: Mapping[str, str] = {
    "t": "time [s]",
    "dt": "length of what is moved on by: period of the component's clock, or the step [s]",
    "x": "states, a record",
    "u": "inputs, a record",
    "p": "parameters and derived constants, a record",
    "y": "outputs, a record",
    "dx": "rates of change of the states, a record to write",
    "x_next": "states at the end, a record to write",
    "tables": "pool of all arrays that `derive` has given; `p.<name>` is the offset of one",
    "delays": "pool of all delay lines; `p.line` is the first cell of this component's",
    "n": "Norton equivalent of a machine: conductances, currents, and its speed and angle at the end of the stage",
    "gh": "length of a stage of the network [s]",
    "fraction": "where in the coming step the component's sampling instant falls, 0 to 1; -1 if it does not",
    "phase": "phase of the component's clock at the step's start, in periods",
    "phase_next": "phase at its end",
}
"""Every argument a kernel may have."""

SIGNAL, ELEMENT, MACHINE, ANY = "signal component", "linear element", "machine", "any"


@dataclass(frozen=True)
class KernelContract:
    """What one sort of kernel is handed and has to do.

    Attributes
    ----------
    of : str
        What may have it.
    arguments : tuple of str
        Names of arguments that it may ask for.
    writes : tuple of str
        Those that it writes; a kernel without any returns a number.
    when : str
        When it is called, and what for.
    """

    of: str
    arguments: tuple[str, ...]
    writes: tuple[str, ...]
    when: str


_SEEN = ("x", "u", "p", "y", "tables")

CONTRACT: Mapping[str, KernelContract] = {
    "derivatives": KernelContract(
        ANY,
        ("t", "x", "u", "p", "dx", "tables", "delays"),
        ("dx",),
        "rates of the states. Of a signal component: twice a step (Heun), or in its own period. Of a linear element: "
        "at assembly, for its matrices; it has to be linear in x and u. Analyses call it with complex numbers.",
    ),
    "outputs": KernelContract(
        ANY,
        ("t", "x", "u", "p", "y", "tables", "delays"),
        ("y",),
        "outputs from states and inputs, after these have changed. Of a linear element: at assembly, as `derivatives`.",
    ),
    "update": KernelContract(
        SIGNAL,
        ("t", "dt", "x", "u", "p", "x_next", "y", "tables", "delays"),
        ("x_next", "y"),
        "what a sampled component does at an instant of its clock: next states, and outputs that hold until the next "
        "one. `x_next` begins as a copy of `x`.",
    ),
    "modulate": KernelContract(
        SIGNAL,
        ("t", "dt", "x", "u", "p", "y", "fraction", "phase", "phase_next", "tables", "delays"),
        ("x", "y"),
        "what drives switches in the coming step: called in every step, before the network is solved.",
    ),
    "limit": KernelContract(
        ANY,
        ("t", "x", "u", "p", "tables"),
        ("x",),
        "brings states back into their range after they have been moved on.",
    ),
    "stamp": KernelContract(
        MACHINE,
        ("t", "gh", "x", "u", "p", "n", "tables", "delays"),
        ("n",),
        "Norton equivalent of an implicit Euler step of length gh from x, linearised there; twice a step.",
    ),
    "advance": KernelContract(
        MACHINE,
        ("t", "gh", "x", "u", "p", "n", "x_next", "tables", "delays"),
        ("x_next",),
        "states at the end of that step, once the voltages at its terminals are known.",
    ),
    "isolated": KernelContract(
        MACHINE,
        ("x", "u", "p", "tables", "delays"),
        ("x",),
        "once at a start, for a device that nothing else meets: brings its states where they rest.",
    ),
    "stored_energy": KernelContract(ANY, ("x", "u", "p", "tables"), (), "energy [J] that it stores: at start and end."),
    "losses": KernelContract(ANY, _SEEN, (), "power [W] that turns into heat: at every audit, 1 ms apart."),
    "supplied": KernelContract(ANY, _SEEN, (), "power [W] that comes from outside of the plant: at every audit."),
    "consumed": KernelContract(ANY, _SEEN, (), "power [W] that leaves the plant as useful work: at every audit."),
}
"""The kernels a device may have."""


def refuse_unknown(name: str, function: Callable[..., Any], arguments: tuple[str, ...]) -> None:
    """Refuse a kernel that asks for what nobody hands it.

    Parameters
    ----------
    name : str
        Which kernel of a device it is.
    function : function
    arguments : tuple of str
        What it asks for.

    Raises
    ------
    TypeError
        With what it may ask for, and what each is.
    """
    contract = CONTRACT[name]
    unknown = [argument for argument in arguments if argument not in contract.arguments]
    if not unknown:
        return
    plain = getattr(function, "py_func", function)
    where = f"{plain.__code__.co_filename}:{plain.__code__.co_firstlineno}"
    known = "; ".join(f"{argument}: {ARGUMENTS[argument]}" for argument in contract.arguments)
    asks = ", ".join(f"'{argument}'" for argument in unknown)
    raise TypeError(f"{where}: {plain.__name__} ({name}) asks for {asks}, expected some of: {known}")


def contract_table() -> str:
    """The contract as two tables in Markdown, of kernels and of their arguments."""
    rows = ["| kernel | of | may ask for | writes | when, and what for |", "|---|---|---|---|---|"]
    for name, contract in CONTRACT.items():
        asks = " ".join(f"`{argument}`" for argument in contract.arguments)
        writes = " ".join(f"`{argument}`" for argument in contract.writes) or "returns a number"
        rows.append(f"| `{name}` | {contract.of} | {asks} | {writes} | {contract.when} |")
    rows += ["", "| argument | what it is |", "|---|---|"]
    rows += [f"| `{name}` | {meaning} |" for name, meaning in ARGUMENTS.items()]
    return "\n".join(rows) + "\n"
