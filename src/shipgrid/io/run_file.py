"""A run's `run.yaml` read back: the ship, the scenario and the options it was made with, to repeat it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

from shipgrid.equipment.ship import Ship
from shipgrid.errors import InputErrors, ParameterError
from shipgrid.io.quantities import parse_quantity
from shipgrid.io.scenario_file import Scenario, read_case
from shipgrid.io.ship_file import check_head, read_parts
from shipgrid.io.yaml_lines import Document, Listing, Problems, Scalar, Section, read_text
from shipgrid.names import mistake_in, shown
from shipgrid.scenarios.outside import Outside, read_outside

KEYS = (
    "schema",
    "fidelity",
    "step",
    "until",
    "version",
    "commit",
    "waveforms",
    "parts",
    "outside",
    "set",
    "ship",
    "scenario",
)


@dataclass(frozen=True)
class RunFile:
    """Everything a run was made with.

    Attributes
    ----------
    ship : Ship
    scenario : Scenario
        Both with the changes that were made for that run.
    fidelity : str
        Detail of the converters.
    step, until : float
        Step and end [s].
    version, commit : str
        Of the program that ran it.
    overrides : dict of str to str
        The `--set` entries that are in the ship and the scenario already.
    waveforms : tuple of (float, float)
        Windows [s] in which every step was recorded.
    outside : tuple of Outside
        Commands that a live run was given while it ran.
    parts : dict of str to tuple of str
        Buses by the name of a part, if the plant was cut.
    """

    ship: Ship
    scenario: Scenario
    fidelity: str
    step: float
    until: float
    version: str
    commit: str
    overrides: dict[str, str]
    waveforms: tuple[tuple[float, float], ...] = ()
    outside: tuple[Outside, ...] = ()
    parts: dict[str, tuple[str, ...]] = field(default_factory=dict)


def is_run_file(document: Document) -> bool:
    """Whether a document is a `run.yaml`: neither a ship nor a scenario file has the other in it."""
    return "ship" in document.root and "scenario" in document.root


def read_run_file(document: Document, overrides: Iterable[tuple[str, str]] = ()) -> RunFile:
    """The run that a `run.yaml` describes.

    Parameters
    ----------
    document : Document
        As read.
    overrides : iterable of (path, value)
        Changes to its ship or scenario, as `--set` makes them.

    Raises
    ------
    InputErrors
        With every mistake in it; lines of the ship and the scenario in it are counted from their own beginning.
    """
    root, problems = document.root, Problems(list(document.problems.found))
    check_head(root, problems, KEYS)

    def text(key: str, expected: str) -> str:
        node = root.get(key)
        if isinstance(node, Scalar) and not node.empty:
            return node.text
        place = root.place if node is None else node.place
        problems.add(place, key, f"{'missing' if node is None else 'is not one value'}, expected {expected}")
        return ""

    def seconds(key: str) -> float:
        written = text(key, "a time, such as '30 us'")
        try:
            return parse_quantity(written, "s") if written else 0.0
        except ParameterError as wrong:
            problems.add(root.entries[key].place, key, str(wrong))
        return 0.0

    fidelity, step, until = text("fidelity", "averaged"), seconds("step"), seconds("until")
    version, commit = text("version", "that of the program"), text("commit", "that of the program")
    ship, scenario = (text(part, f"the text of the {part} file") for part in ("ship", "scenario"))
    listed = root.get("waveforms")
    windows = []
    for item in listed.items if isinstance(listed, Listing) else ():
        parts = item.text.split(":", 1) if isinstance(item, Scalar) else []
        try:
            start, end = (parse_quantity(part, "s") for part in parts)
            windows.append((start, end))
        except (ParameterError, ValueError):
            problems.add(item.place, "waveforms", "is not a window, expected FROM:TO, such as 170 s:170.2 s")
    commands = text("outside", "a file of commands") if "outside" in root else ""
    if commands and (wrong := mistake_in(commands)):
        what = f"{shown(commands)} is no file beside this one: {wrong}, expected such as commands.csv"
        problems.add(root.entries["outside"].place, "outside", what)
    file = Path(document.file).parent / commands if commands else None
    cut = read_parts(root, problems)
    changed = root.get("set")
    earlier = {path: n.text for path, n in changed if isinstance(n, Scalar)} if isinstance(changed, Section) else {}
    problems.raise_if_any()
    pairs = list(overrides)
    ship_document = read_text(ship, f"{document.file}: ship")
    scenario_document = read_text(scenario, f"{document.file}: scenario")
    loaded_ship, loaded_scenario = read_case(ship_document, scenario_document, pairs)
    if not 0.0 < until <= loaded_scenario.duration:
        end = f"{loaded_scenario.duration:g} s"
        raise InputErrors([f"{root.entries['until'].place}: until: is not within the scenario, expected up to {end}"])
    given: list[Outside] = []
    if file is not None and file.is_file():  # a live run that nobody commanded has none
        try:
            given = read_outside(file, loaded_ship.commands)
        except OSError as wrong:
            raise InputErrors([f"{root.entries['outside'].place}: outside: {file} cannot be read: {wrong}"]) from wrong
    overridden = {**earlier, **dict(pairs)}
    options = (fidelity, step, until, version, commit, overridden, tuple(windows), tuple(given), cut)
    return RunFile(loaded_ship, loaded_scenario, *options)
