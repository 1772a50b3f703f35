"""Operating modes of a plant: each a set of the commands an operator has, and nothing else.

    full-electric   batteries on in droop, no recharge; gensets off
    hybrid          batteries on in droop; the first genset on, sharing the bus by droop, the others as they are
    diesel          all gensets on, sharing the bus by droop; batteries off

Set points (recharge current, voltages, ship speed) belong to the operator and stay, but for the recharge that
full-electric ends. Commands of one mode are given together; what is not safe yet, as switching the batteries off before
a genset holds the bus, is held back by the interlocks (`automation/interlocks.py`) until it is.

Source: [DAgostino2020] sec. 2 and fig. 8.
"""

from __future__ import annotations

from collections.abc import Mapping

FULL_ELECTRIC, HYBRID, DIESEL = MODES = ("full-electric", "hybrid", "diesel")


def mode_commands(mode: str, commands: Mapping[str, object], kinds: Mapping[str, str]) -> dict[str, str]:
    """The commands of a mode for a ship, as a scenario file says them.

    Parameters
    ----------
    mode : str
        One of `MODES`.
    commands : mapping
        The ship's commands, by path.
    kinds : mapping of str to str
        Kind of each item, by name.

    Returns
    -------
    dict of str to str
        Value by path; empty where the ship has neither battery nor genset.
    """
    sources = {kind: [name for name, its in kinds.items() if its == kind] for kind in ("bess", "genset", "rectifier")}
    running = {FULL_ELECTRIC: 0, HYBRID: 1, DIESEL: len(sources["genset"])}[mode]
    given = {}
    for name in sources["rectifier"] if running else ():
        given[f"{name}.mode"] = "droop"
    for k, name in enumerate(sources["genset"]):
        if k < running or running == 0:
            given[f"{name}.on"] = "true" if k < running else "false"
    for name in sources["bess"]:
        given[f"{name}.on"] = "false" if mode == DIESEL else "true"
        if mode != DIESEL:
            given[f"{name}.mode"] = "droop"
        if mode == FULL_ELECTRIC:
            given[f"{name}.i_ref"] = "0 A"
    return {path: value for path, value in given.items() if path in commands}
