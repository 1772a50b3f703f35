"""A genset on a load bank: what governor and voltage regulator make of load steps.

    python examples/plot_genset_load_bank.py [--out FIGURE.png]

Machine, engine, governor and exciter are wired by hand, as a test bed would be. The set runs up its field without
load, and the run goes on from where that one ended.
"""

# %% One import for the simulator, one for the figure.
from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

import shipgrid as sg
from shipgrid.components.mechanical.diesel_engine import DieselEngine
from shipgrid.controllers.exciter_ac1a import Ac1a
from shipgrid.controllers.governor_degov1 import Degov1

RATING, V, F = 596e3, 480.0, 60.0  # VA, V, Hz
STEPS = (0.08, 0.25, 0.25)  # pu of the rating: the local load, then two banks
BANK_1, BANK_2, BANK_2_OFF, END = 1.0, 5.0, 9.0, 13.0  # s
SETTLING = 12.0  # s
CONTROL = sg.Every(0.5e-3)


# %% The set: signals by name, in whatever order.
def circuit(engine: DieselEngine | None = None, clock: sg.Every | None = CONTROL) -> sg.Network:
    """Genset with three loads of its own.

    Parameters
    ----------
    engine : DieselEngine, optional
        Engine, in place of the default.
    clock : Every, optional
        When governor, engine and exciter run; every step if None.
    """
    net = sg.Network("genset on a load bank")
    bus = net.ac_bus("bus", v_n=V, f_n=F)
    machine = sg.SynchronousGenerator(S_n=RATING, v_n=V, f_n=F)
    drive = {"E_fd": "exciter.E_fd", "T_m": "engine.T_m"}
    net.add("machine", machine, a=bus, inputs=drive, initial={"omega": 1.0})
    speed = {"omega": "machine.omega", "omega_ref": 1.02}
    net.add("governor", Degov1(), inputs=speed, clock=clock)
    fuel = {"throttle": "governor.throttle", "omega": "machine.omega"}
    net.add("engine", engine or DieselEngine(), inputs=fuel, clock=clock)
    field = {"v_t": "machine.v_t", "v_ref": 1.0, "i_fd": "machine.i_fd"}
    net.add("exciter", Ac1a(), inputs=field, clock=clock)
    local, first, second = (V**2 / (share * RATING) for share in STEPS)
    net.add("local", sg.Resistor(R=local), a=bus)
    net.add("bank_1", sg.Resistor(R=first), a=bus, contact="open")
    net.add("bank_2", sg.Resistor(R=second), a=bus, contact="open")
    return net


# %% Settle, then step the load: a run goes on from the end of another.
def simulate(step: float = 30e-6) -> sg.CircuitRun:
    """Two load steps on, one off.

    Parameters
    ----------
    step : float
        Step length [s].
    """
    plan = sg.assemble(circuit(), step=step)
    names = ["machine.omega", "machine.v_t", "machine.p_pu", "governor.throttle", "exciter.E_fd"]
    rest = plan.run(until=SETTLING, record=names, every=100)
    events = [
        sg.At(SETTLING + BANK_1, sg.Close("bank_1")),
        sg.At(SETTLING + BANK_2, sg.Close("bank_2")),
        sg.At(SETTLING + BANK_2_OFF, sg.Open("bank_2")),
    ]
    return plan.run(rest.end, events=events, until=SETTLING + END, record=names, every=50)


# %% One figure.
def draw(run: sg.CircuitRun, path: Path) -> None:
    """Draw power, speed, voltage and field voltage into a file."""
    panels = {
        "machine.p_pu": "power, pu",
        "machine.omega": "speed, pu",
        "machine.v_t": "voltage, pu",
        "exciter.E_fd": "field voltage, pu",
    }
    figure, axes = plt.subplots(len(panels), 1, sharex=True, figsize=(7.5, 7.5), constrained_layout=True)
    for axis, (name, label) in zip(axes, panels.items(), strict=True):
        axis.plot(run[name]["time"] - SETTLING, run[name], lw=1.2)
        axis.set_ylabel(label)
        axis.grid(alpha=0.3)
    axes[-1].set_xlabel("time, s")
    axes[0].set_title("596 kVA genset, resistive banks of 25 % on, on, off", fontsize=10)
    figure.savefig(path, dpi=110)
    plt.close(figure)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", default=Path("genset_load_bank.png"), type=Path)
    draw(simulate(), parser.parse_args().out)
