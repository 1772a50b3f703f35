"""Parts for small-signal tests that no ship has, as constant-power loads and ideal lags; and small plants."""

from __future__ import annotations

import math

import numpy as np

from shipgrid.assembly.assemble import assemble
from shipgrid.components.converters.buck_boost import BuckBoost
from shipgrid.components.electrical.lcl_filter import LclFilter
from shipgrid.components.electrical.load import Load
from shipgrid.components.electrical.rl_branch import RlBranch
from shipgrid.components.machines.pmsm import Pmsm
from shipgrid.components.mechanical.diesel_engine import DieselEngine
from shipgrid.components.mechanical.shaft import Shaft
from shipgrid.components.sources.dc_source import CurrentSource, InductiveDcSource
from shipgrid.components.sources.synchronous_generator import SynchronousGenerator
from shipgrid.components.sources.three_phase_source import ThreePhaseSource
from shipgrid.controllers.battery_control import VOLTAGE, BatteryControl
from shipgrid.controllers.dc_voltage import DcVoltageState, dc_voltage
from shipgrid.controllers.drive_current import DriveCurrent
from shipgrid.controllers.exciter_ac1a import Ac1a
from shipgrid.controllers.governor_degov1 import Degov1
from shipgrid.controllers.grid_forming import droop
from shipgrid.controllers.motor_speed import MotorSpeed
from shipgrid.controllers.rectifier_control import RectifierControl
from shipgrid.equipment.wiring import add_bridge, add_leg
from shipgrid.model import component, kernel, param, signal
from shipgrid.model.connections import Pole3
from shipgrid.model.network import Network
from shipgrid.model.placed import Every, Sampled
from shipgrid.units import (
    Ampere,
    NewtonMetre,
    PerUnit,
    PerUnitPerSecond,
    Radian,
    RadianPerSecond,
    Ratio,
    Second,
    Volt,
    Watt,
)
from validation.hotel_rig import DESIGN, controller, filter_of

OMEGA = 2.0 * math.pi * 60.0
AXES = ("alpha", "beta")
STIFF = {"R": 1e-6, "L": 1e-9}
"""Impedance of a source that is none."""
TAKEN = CurrentSource(i_0=-1.0)
"""Takes the current that its input `i_pu` says, in ampere."""


class PowerInput:
    v: Volt = signal("bus voltage")
    power: Watt = signal("power taken")


class PowerOutput:
    i: Ampere = signal("current that takes it")


@kernel
def power_outputs(u, y):
    y.i = u.power / u.v


@component(input=PowerInput, output=PowerOutput, outputs=power_outputs, stage="outer")
class ConstantPower:
    """Current of a constant-power load."""


class LoopState:
    dc: DcVoltageState
    i: PerUnit = signal("current into the bus")


class LoopInput:
    v_dc: Volt = signal("bus voltage")
    v_ref: Volt = signal("its reference")
    mode: Ratio = signal("0 droop, 1 voltage")


class LoopOutput:
    i: Ampere = signal("current taken from the bus")


@kernel
def loop_update(dt, x, u, p, x_next, y):
    i_ref = dc_voltage(u.v_ref / 750.0, u.v_dc / 750.0, x.i, u.mode, 1.0 + 0.0 * u.v_ref, 9.0, p, dt, x.dc, x_next.dc)
    x_next.i = x.i + dt / p.T_lag * (i_ref - x.i)
    y.i = -x.i * p.I_b


@component(state=LoopState, input=LoopInput, output=LoopOutput, stage="inner", update=loop_update)
class IdealRectifier:
    """The rectifier's DC control on a current that follows its reference with a lag."""

    T_lag: Second = param("lag", default=3.66e-3, above=0.0)
    I_b: Ampere = param("base", default=596e3 / 750.0, above=0.0)
    K_v: PerUnit = param("droop", default=0.05, above=0.0)
    K_p_dc: PerUnit = param("gain", default=0.2, above=0.0)
    K_i_dc: PerUnitPerSecond = param("gain", default=0.5, above=0.0)
    K_p_form: PerUnit = param("gain", default=2.0, above=0.0)
    K_i_form: PerUnitPerSecond = param("gain", default=20.0, above=0.0)


class FieldState:
    E: PerUnit = signal("voltage behind the field")


class FieldInput:
    E_fd: PerUnit = signal("field voltage")


@kernel
def field_derivatives(x, u, p, dx):
    dx.E = (u.E_fd - x.E) / p.T_d01


@component(state=FieldState, input=FieldInput, derivatives=field_derivatives)
class Field:
    """An unloaded machine as its field alone."""

    T_d01: Second = param("open-circuit time constant", default=3.5, above=0.0)


class SwingState:
    v_set: PerUnit = signal("as in the controller", initial=1.0)
    power: PerUnit = signal("as in the controller")
    lead: PerUnit = signal("as in the controller")
    reactive: PerUnit = signal("as in the controller")
    delta: Radian = signal("angle before the bus")


class SwingInput:
    v_ref: PerUnit = signal("as in the controller", initial=1.0)
    p_ref: PerUnit = signal("as in the controller", initial=0.0)
    q_ref: PerUnit = signal("as in the controller", initial=0.0)
    omega_ref: PerUnit = signal("as in the controller", initial=1.0)
    dp_sync: PerUnit = signal("trim", initial=0.0)
    dw_sync: PerUnit = signal("as in the controller", initial=0.0)
    dV_sync: PerUnit = signal("as in the controller", initial=0.0)
    dw_join: PerUnit = signal("as in the controller", initial=0.0)
    dV_join: PerUnit = signal("as in the controller", initial=0.0)


@kernel
def swing_update(dt, x, u, p, x_next):
    omega, _ = droop(np.sin(x.delta) / p.X, 0.0 * x.delta, dt, x, u, p, x_next)
    x_next.delta = x.delta + dt * OMEGA * (omega - 1.0)


@component(state=SwingState, input=SwingInput, stage="inner", update=swing_update)
class Swing:
    """The grid-forming inverter's droops on a reactance to a stiff bus, its voltage ideal."""

    X: PerUnit = param("reactance", above=0.0)
    T_1: Second = param("lead", default=0.033, above=0.0)
    T_2: Second = param("lag", default=0.011, above=0.0)
    m_p: PerUnit = param("droop", default=0.02, above=0.0)
    m_q: PerUnit = param("droop", default=0.02, above=0.0)
    omega_c: RadianPerSecond = param("low-pass", default=31.41, above=0.0)
    omega_q: RadianPerSecond = param("low-pass", default=31.41, above=0.0)
    v_rate: PerUnitPerSecond = param("ramp", default=1.0, above=0.0)


class TorqueInput:
    omega: RadianPerSecond = signal("speed")
    k: Ratio = signal("torque over speed, N m s")


class TorqueOutput:
    tau: NewtonMetre = signal("torque")


@kernel
def torque_outputs(u, y):
    y.tau = u.k * u.omega


@component(input=TorqueInput, output=TorqueOutput, outputs=torque_outputs, stage="outer")
class LinearTorque:
    """A screw as a torque that goes with the speed."""


# plants


def machine_on_stiff_bus(item=None):
    """A generator on an ideal source, torque and field voltage open inputs."""
    item = item or SynchronousGenerator(T_d01=3.5, brushless=0.0)
    net = Network("machine on a stiff bus")
    bus = net.ac_bus("bus", 480.0, 60.0)
    net.add("grid", ThreePhaseSource(v_n=480.0, **STIFF), a=bus)
    inputs = {"E_fd": net.command("E_fd", 1.5), "T_m": net.command("T_m", 0.5)}
    net.add_three_phase("machine", item, ports={"stator": bus}, inputs=inputs)
    return assemble(net, 30e-6)


def genset(load=0.0, **machine):
    """Governor, engine, machine and exciter on a resistance of `load` [pu]; both references are commands."""
    net = Network("genset")
    bus = net.ac_bus("bus", 480.0, 60.0)
    net.conductance(bus, max(load, 1e-6) * 596e3 / 480.0**2)
    net.add_three_phase(
        "machine",
        SynchronousGenerator(**machine),
        ports={"stator": bus},
        inputs={"E_fd": "exciter.E_fd", "T_m": "engine.T_m"},
    )
    clock = Every(0.5e-3)
    net.add("engine", DieselEngine(), inputs={"throttle": "governor.throttle", "omega": "machine.omega"}, clock=clock)
    reference = {"omega_ref": net.command("omega_ref", 1.0)}
    net.add("governor", Degov1(), inputs={"omega": "machine.omega", **reference}, clock=clock)
    inputs = {"v_t": "machine.v_t", "v_ref": net.command("v_ref", 1.0), "i_fd": "machine.i_fd"}
    net.add("exciter", Ac1a(), inputs=inputs, clock=clock)
    return assemble(net, 100e-6)


GENSET_START = {"machine.omega": 1.0, "machine.psi_d": 0.99, "machine.psi_f": 1.04, "machine.psi_kd": 0.99,
                "exciter.v_m": 1.0, "exciter.v_e": 1.2, "exciter.v_a": 1.5, "exciter.x_f": 1.5,
                "bus.v_beta": 390.0, "exciter.E_fd": 1.0}  # fmt: skip


def exciter_on_field(T_d01, **exciter):
    """AC1A on an unloaded machine that is its field alone: v_t = i_fd = E."""
    net = Network("voltage loop")
    net.add("field", Field(T_d01=T_d01), inputs={"E_fd": "exciter.E_fd"})
    net.add("exciter", Ac1a(**exciter), inputs={"v_t": "field.E", "v_ref": 1.0 + 1.4986 / 600.0, "i_fd": "field.E"})
    return assemble(net, 1e-4)


def rectifier(
    *, control=None, source=0.0, f_s=3240.0, R_d=None, capacitance=17e-3, mode=0.0, stiff=None, L_1=1.29, e=1.0
):
    """Active rectifier between a stiff three-phase voltage and a DC bus with a constant-power load (`power`)."""
    lcl = LclFilter.per_unit(596e3, 480.0, 60.0, L_1=L_1, C=0.07, L_2=0.09)
    z_b = 480.0**2 / 596e3
    L_2, R_d = lcl.L_2 + source, lcl.R_d if R_d is None else R_d * z_b
    lcl = LclFilter(L_1=lcl.L_1, R_1=lcl.R_1, C=lcl.C, R_d=R_d, L_2=L_2, R_2=lcl.R_2)
    net = Network("rectifier")
    dc, ac = net.dc_bus("dc", 750.0), net.ac_bus("ac", 480.0, 60.0)
    net.capacitance(dc, capacitance)
    net.add("grid", ThreePhaseSource(v_n=e * 480.0, **STIFF), a=ac)
    bridge = add_bridge(net, "rectifier", dc, control="control", gates=1.0, clock=Sampled(f_s), f_sw=f_s)
    net.add_three_phase("lcl", lcl, ports={"converter": bridge, "grid": ac})
    measured = {f"{name}_{axis}": f"lcl.{axis}.{name}" for axis in AXES for name in ("v_c", "i_1", "i_2")}
    net.add(
        "control",
        control or RectifierControl(),
        inputs=measured | {"v_dc": "dc.v_dc", "v_dc_ref": net.command("v_dc_ref", 750.0), "mode": mode, "enable": 1.0},
        clock=Sampled(f_s),
    )
    if stiff is None:
        net.add("load", ConstantPower(), inputs={"v": "dc.v_dc", "power": net.command("power", 0.0)})
        net.add("taken", TAKEN, inputs={"i_pu": "load.i"}, a=dc)
    else:
        net.add("bus", InductiveDcSource(v_0=stiff, R=1e-3, L=1e-9), a=dc)
    return assemble(net, 30e-6)


RECTIFIER_START = {"ac.v_alpha": 392.0, "lcl.alpha.v_c": 392.0, "lcl.alpha.i_1": -189.0, "lcl.alpha.i_2": -189.0,
                   "control.v_ff_d": 1.0, "control.v_f": 1.0, "control.dc.pi.i": 0.187, "control.i_dc_f": 0.187,
                   "control.vs_d": 1.0, "control.vs_q": -0.25, "rectifier.bridge.s_alpha": 0.52,
                   "rectifier.bridge.s_beta": -0.13}  # fmt: skip
"""Near 0.19 pu of load."""


def dc_loop(mode=0.0, **gains):
    """The rectifier's DC control on an ideal lag, 10 mF, a constant-power load: reading B, or A with mode 1."""
    net = Network("dc loop")
    dc = net.dc_bus("dc", 750.0)
    net.capacitance(dc, 10e-3)
    inputs = {"v_dc": "dc.v_dc", "v_ref": net.command("v_ref", 750.0), "mode": mode}
    item, start = IdealRectifier(**gains), {"dc.mode": mode}
    net.add("rectifier", item, inputs=inputs, initial=start, clock=Every(2e-6))
    net.add("fed", TAKEN, inputs={"i_pu": "rectifier.i"}, a=dc)
    net.add("load", ConstantPower(), inputs={"v": "dc.v_dc", "power": net.command("power", 0.0)})
    net.add("taken", TAKEN, inputs={"i_pu": "load.i"}, a=dc)
    return assemble(net, 2e-6)


def grid_forming(preset, loads, conductance=0.0, units=1, f_s=1620.0, **changes):
    """Inverters on one bar, each with its own filter, on a stiff DC bus."""
    control = controller(preset, **(DESIGN if preset == "default" else {}) | changes)
    lcl = filter_of(control)
    net = Network("grid forming")
    dc, ac = net.dc_bus("dc", 750.0), net.ac_bus("ac", 400.0, 60.0)
    net.capacitance(dc, 10e-3)
    net.add("battery", InductiveDcSource(v_0=750.0, R=1e-3, L=1e-9), a=dc)
    for k in range(units):
        name = f"inverter_{k}"
        clock = Sampled(f_s)
        bridge = add_bridge(net, name, dc, control=f"{name}.control", gates=1.0, clock=clock, f_sw=f_s)
        net.add_three_phase(f"{name}.lcl", lcl, ports={"converter": bridge, "grid": ac})
        states = (("v_c", "v_c"), ("i_1", "i_1"), ("i_g", "i_2"))
        measured = {f"{to}_{axis}": f"{name}.lcl.{axis}.{of}" for axis in AXES for to, of in states}
        inputs = measured | {"v_dc": "dc.v_dc", "enable": 1.0, "p_ref": net.command(f"{name}.p_ref", 0.0)}
        net.add(f"{name}.control", control, inputs=inputs, initial={"v_set": 1.0}, clock=clock)
    if conductance:
        net.conductance(ac, conductance)
    for k, load in enumerate(loads):
        net.add_three_phase(f"load_{k}", load, ports={type(load).__component__.terminals[0].name: ac})
    return assemble(net, 30e-6)


def near_nominal(units=1):
    """Where the search for an inverter's operating point starts: at nominal voltage, lightly loaded."""
    found = {"ac.v_alpha": 326.0}
    for k in range(units):
        unit = f"inverter_{k}"
        found |= {f"{unit}.lcl.alpha.v_c": 326.0, f"{unit}.lcl.alpha.i_1": 15.0, f"{unit}.lcl.alpha.i_2": 15.0}
        found |= {f"{unit}.control.v_c_forward.d": 1.0, f"{unit}.control.i_g_slow.d": 0.15}
        found |= {f"{unit}.control.voltage.d": 0.05, f"{unit}.control.current.d": 0.5}
        found |= {f"{unit}.control.power": -0.15, f"{unit}.control.lead": -0.15, f"{unit}.bridge.s_alpha": 0.43}
    return found


def series(p, power_factor=0.9):
    return (Load(p_0=p, power_factor=power_factor),), 0.0


def parallel(p, power_factor=0.9):
    q = p * math.tan(math.acos(power_factor))
    return (RlBranch(R=0.0, L=400.0**2 / q / OMEGA),), p / 400.0**2


def swing(X, T_1):
    """The droops alone against a stiff bus, sampled so often that they are as good as continuous."""
    net = Network("swing")
    net.add("inverter", Swing(X=X, T_1=T_1))
    return assemble(net, 1e-6)


def shaft_line():
    """Motor, drive and speed control on a stiff DC bus; the screw's torque goes with the speed."""
    net = Network("shaft line")
    dc = net.dc_bus("dc", 750.0)
    net.capacitance(dc, 5e-3)
    net.add("bus", InductiveDcSource(v_0=750.0, R=1e-3, L=1e-9), a=dc)
    motor = Pmsm()
    at_bus = {"v_dc": "dc.v_dc"}
    speed = {"n_ref": net.command("n_ref", 0.3), "omega_pu": "shaft.omega_pu", **at_bus}
    net.add("speed", MotorSpeed(), inputs=speed)
    drive = DriveCurrent(R=motor.R_s)
    measured = {"tau_ref": "speed.tau_ref", "i_d": "motor.i_d", "i_q": "motor.i_q", "theta_e": "motor.theta_e"}
    net.add("drive", drive, inputs=measured | {"omega_m": "shaft.omega_m", **at_bus})
    stator = Pole3(dc, s_alpha="drive.s_alpha", s_beta="drive.s_beta")
    net.add_three_phase("motor", motor, ports={"stator": stator}, inputs={"omega_m": "shaft.omega_m"})
    net.add("screw", LinearTorque(), inputs={"omega": "shaft.omega_m", "k": net.command("k", 0.0)})
    net.add("shaft", Shaft(eta_s=1.0), inputs={"tau_e": "motor.tau_e", "tau": "screw.tau"})
    return assemble(net, 30e-6)


def battery_forming(capacitance):
    """One battery that forms the bus, its voltage constant, with a constant-power load (`power`)."""
    net = Network("battery")
    dc = net.dc_bus("dc", 750.0)
    net.capacitance(dc, capacitance)
    leg = add_leg(net, "battery", dc, control="control", gates=1.0, clock=Sampled(5000.0), f_sw=5000.0)
    net.add("converter", BuckBoost(), ports={"leg": leg}, inputs={"e": 474.0})
    net.add(
        "control",
        BatteryControl(),
        inputs={"i_l": "converter.i_l", "v_b": "converter.v_c", "v_dc": "dc.v_dc", "soc": 0.5, "enable": 1.0}
        | {"mode_ref": VOLTAGE, "v_dc_ref": 750.0, "i_ref": 0.0},
        initial={"mode": VOLTAGE},
        clock=Sampled(5000.0),
    )
    net.add("load", ConstantPower(), inputs={"v": "dc.v_dc", "power": net.command("power", 10e3)})
    net.add("taken", TAKEN, inputs={"i_pu": "load.i"}, a=dc)
    return assemble(net, 30e-6)
