"""The command `shipgrid`: its commands, each in the file of its name, in the order of `shipgrid --help`.

Everything heavy is imported inside the command that needs it, so that `--help` and `check` answer at once. What the
exit status means: `exit_status.py`.
"""

from __future__ import annotations

from collections.abc import Callable

import typer

from shipgrid.cli.bench import bench, warm
from shipgrid.cli.check import check
from shipgrid.cli.explain import explain
from shipgrid.cli.list import list_
from shipgrid.cli.live import live
from shipgrid.cli.parts import parts
from shipgrid.cli.results import compare, plot
from shipgrid.cli.run import run

app = typer.Typer(
    name="shipgrid",
    help="Electromagnetic-transient simulation of shipboard DC microgrids.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)

app.command("run")(run)
app.command("live")(live)
app.command("parts")(parts)
app.command("check")(check)
app.command("explain")(explain)
app.command("list")(list_)
app.command("plot")(plot)
app.command("compare")(compare)
app.command("warm")(warm)
app.command("bench")(bench)

main: Callable[[], None] = app

if __name__ == "__main__":
    main()
