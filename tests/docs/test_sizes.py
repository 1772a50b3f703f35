"""A file holds one idea and a function fits on a screen; what does not has its reason here."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

SOURCE = Path(__file__).parents[2] / "src" / "shipgrid"
LONGEST_FILE, LONGEST_FUNCTION = 500, 70
"""Lines; of a function without its docstring."""

FILES = {
    "equipment/rectifier.py": "half of it is the design of its filter, which moves to the rules for any ship",
    "io/scenario_file.py": "one reader; it falls apart with the readers over fields",
    "io/ship_file.py": "one reader; it falls apart with the readers over fields",
    "scenarios/session.py": "the pieces of a step, and three who use them",
    "solvers/conduction.py": "one algorithm, with the physics of every state of a leg",
    "solvers/nodal.py": "a third of it are the fields of two records, each with its meaning",
}
FUNCTIONS = {
    "assembly/layout.py: lay_out": "one pass that gives every signal its place; still to be cut",
    "assembly/network_plan.py: _bridges": "one pass over the bridges; still to be cut",
    "assembly/network_plan.py: network_plan": "one pass over the elements; still to be cut",
    "controllers/battery_control.py: update": "one law, a line an equation",
    "controllers/rectifier_control.py: update": "one law, a line an equation",
    "equipment/bess.py: build": "shrinks once items declare what they publish",
    "equipment/inverter.py: build": "shrinks once items declare what they publish",
    "equipment/propulsion.py: build": "shrinks once items declare what they publish",
    "io/schema.py: scenario_schema": "one description of a file, in its order",
    "modulators/hysteresis.py: hysteresis_modulate": "one search for the crossings in a step",
    "scenarios/simulate.py: simulate": "falls with its seventeen parameters, once a case is what is run",
    "solvers/conduction.py: constrain": "compiled as one: its arrays are passed on by name",
    "solvers/conduction.py: settle_legs": "compiled as one: its arrays are passed on by name",
    "solvers/conduction.py: release": "compiled as one: its arrays are passed on by name",
    "solvers/pacing.py: end_step": "compiled as one: its arrays are passed on by name",
}


def files():
    return sorted(SOURCE.rglob("*.py"))


def length(function: ast.AST) -> int:
    """Lines of a function without those of its docstring."""
    first = function.body[0]
    documented = isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant)
    return function.end_lineno - function.lineno + 1 - (first.end_lineno - first.lineno + 1 if documented else 0)


@pytest.mark.parametrize("path", files(), ids=lambda path: str(path.relative_to(SOURCE)))
def test_a_file_holds_one_idea_and_its_functions_fit_on_a_screen(path):
    name, text = str(path.relative_to(SOURCE)), path.read_text()
    long = len(text.splitlines()) > LONGEST_FILE
    assert long == (name in FILES), f"{name} has {len(text.splitlines())} lines"
    functions = [n for n in ast.walk(ast.parse(text)) if isinstance(n, ast.FunctionDef)]
    found = {f"{name}: {n.name}" for n in functions if length(n) > LONGEST_FUNCTION}
    assert found == {known for known in FUNCTIONS if known.startswith(f"{name}: ")}


def test_every_exception_is_of_a_file_that_there_is():
    assert all((SOURCE / name.split(": ")[0]).is_file() for name in (*FILES, *FUNCTIONS))
