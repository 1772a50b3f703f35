"""The file of commands from outside: what is wrong in it is said with its line, and the order of one step is kept."""

from __future__ import annotations

import pytest

from shipgrid.errors import InputErrors
from shipgrid.io.run_file import read_run_file
from shipgrid.io.ship_file import load_ship, open_document
from shipgrid.io.yaml_lines import read_document
from shipgrid.scenarios.output_folder import COMMANDS
from shipgrid.scenarios.outside import Outside, as_lines, merged_commands, read_outside

SCENARIO = "schema: 1\nscenario: short\nduration: 1 s\nstart: {state: moored, closed: [dc_tie]}\n"
RUN = """\
schema: 1
fidelity: averaged
step: 30e-6 s
until: 1.0 s
version: 0.1.0
commit: unknown
outside: commands.csv
set: {}
"""


@pytest.fixture
def run(tmp_path):
    """Writes `commands.csv` beside a `run.yaml`, and reads the run."""
    parts = {"ship": open_document("ship", "ferry").text(), "scenario": SCENARIO}
    blocks = [f"{key}: |2\n" + "".join(f"  {line}\n" for line in text.splitlines()) for key, text in parts.items()]
    (tmp_path / "run.yaml").write_text(RUN + "".join(blocks))

    def read(text):
        (tmp_path / COMMANDS).write_text(text)
        return read_run_file(read_document(tmp_path / "run.yaml"))

    return read


def test_a_file_edited_by_hand_is_read_whole_and_in_order_of_steps(run):
    text = (
        "20,bess_for.i_ref,-192.0,UDP\n\n10,bess_for.mode,2,Modbus\n10,dc_tie.close,0.0,the gateway"  # no end of line
    )
    assert [(c.step, c.path, c.value, c.origin) for c in run(text).outside] == [
        (10, "bess_for.mode", 2.0, "Modbus"),
        (10, "dc_tie.close", 0.0, "the gateway"),
        (20, "bess_for.i_ref", -192.0, "UDP"),
    ]


@pytest.mark.parametrize(
    ("line", "what"),
    [
        ("5,bess_for.i_ref,192.5,UDP", "bess_for.i_ref: 192.5 is out of range, expected -192 .. 192 A ("),
        ("5,bess_for.i_ref,nan,UDP", "bess_for.i_ref: nan is out of range"),
        ("5,bess_for.i_ref,inf,UDP", "bess_for.i_ref: inf is out of range"),
        ("5,bess_for.mode,1.5,UDP", "bess_for.mode: 1.5 is out of range, expected 1 (droop) or 2 (voltage)"),
        ("5,bess_for.current,1.0,UDP", "bess_for.current: the ship has no such command"),
        ("-5,bess_for.i_ref,1.0,UDP", "bess_for.i_ref: step -5 is before the start, expected 0 or more"),
        ("5,bess_for.i_ref,1.0", "is no command, expected step,path,value,origin"),
        ("5.5,bess_for.i_ref,1.0,UDP", "is no command, expected step,path,value,origin"),
        ("5,bess_for.i_ref,30 A,UDP", "is no command, expected step,path,value,origin"),
    ],
)
def test_what_a_ship_would_not_take_is_named_with_its_line(run, tmp_path, line, what):
    with pytest.raises(InputErrors) as caught:
        run(f"1,bess_for.i_ref,1.0,UDP\n{line}\n7,bess_aft.i_ref,1e9,UDP\n")
    first, second = caught.value.problems
    assert first.startswith(f"{tmp_path / COMMANDS}:2: {what}")
    assert second.startswith(f"{tmp_path / COMMANDS}:3: bess_aft.i_ref: 1e9 is out of range")


def test_of_a_killed_run_the_last_line_may_be_half(tmp_path):
    (tmp_path / COMMANDS).write_text("5,bess_for.i_ref,1.0,UDP\n7,bess_for.i_r")
    assert read_outside(tmp_path / COMMANDS, load_ship().commands, torn=True) == [
        Outside(5, "bess_for.i_ref", 1.0, "UDP")
    ]


def test_commands_of_one_step_keep_their_order_and_those_of_two_files_are_there_once(tmp_path):
    values = (3.0, 1.0, 2.0, 1.0, 5.0, 4.0)  # the last of them counts
    first = [Outside(7, "bess_for.i_ref", value, "UDP") for value in values]
    more = [Outside(3, "bess_for.i_ref", 9.0, "UDP"), *first, Outside(7, "bess_for.i_ref", 6.0, "UDP")]
    assert merged_commands(first, more) == [more[0], *first, more[-1]]
    (tmp_path / COMMANDS).write_text(as_lines(merged_commands(first, more)))
    assert read_outside(tmp_path / COMMANDS, load_ship().commands) == merged_commands(first, more)
