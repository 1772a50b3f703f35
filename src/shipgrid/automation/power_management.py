"""Power management: optional rules of a scenario, by which the plant acts on its own; none is in force by default.

    blackout_prevention       propulsion is cut back, within tens of milliseconds, before a source is overloaded
    start_genset_on_low_soc   a genset is started when the batteries are low, recharges them, and is stopped again

The first is a limiter in the plant (`automation/load_limit.py`). The second is an operator: every `PERIOD` it looks at
what the plant shows and gives commands, which pass the interlocks as anybody's do. It works on what it finds; who
gives one of its commands another value while it works has taken over, and it lets go until the batteries are charged.

Source: the paper has no such rules ([DAgostino2020] sec. 7 leaves energy management for later); they are what a
power management system of a ship does, docs/how-to/rules.md.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple, TypeVar, dataclass_transform

from shipgrid.automation.interlocks import DROOP
from shipgrid.automation.load_limit import NOBODY, LoadLimit, SourceLoad, TiePath
from shipgrid.equipment import bess, rectifier
from shipgrid.equipment.declaration import reference
from shipgrid.equipment.hull import T_MARINE
from shipgrid.model.component import param
from shipgrid.model.network import Network
from shipgrid.model.placed import Every
from shipgrid.units import Ampere, PerUnit, Ratio, Second

Declared = TypeVar("Declared", bound=type)


@dataclass_transform(kw_only_default=True, frozen_default=True, field_specifiers=(param, reference))
def rule(cls: Declared) -> Declared:
    """Declare a rule: its fields are what a scenario file may say about it."""
    return dataclass(frozen=True, kw_only=True)(cls)


@rule
class BlackoutPrevention:
    """Propulsion is cut back before a source that feeds it is overloaded."""

    name: ClassVar = "blackout_prevention"

    battery: PerUnit = param(
        "largest current of a battery, over its rated one", default=1.0, above=0.0, source="rated: one hour"
    )
    genset: PerUnit = param(
        "largest power of a genset at its terminals, over its rating",
        default=0.95,
        above=0.0,
        source="typical: room for the governor",
    )
    response: Second = param(
        "time in which an overload is taken away",
        default=50e-3,
        at_least=10e-3,
        at_most=1.0,
        source="chosen: three times slower than the bus under droop; fast load reductions of drives take 0.1 s or more",
    )

    def check(self, ship: Any) -> Iterator[tuple[str, str]]:
        """What is wrong with it for a ship: key (or nothing) and text."""
        if not ship.items("propulsion"):
            yield "", "there is no propulsion to cut back"
        for name, item in ship.items("bess").items():
            if self.battery >= item.i_limit:
                yield (
                    "battery",
                    f"{self.battery:g} pu is not below the {item.i_limit:g} pu at which the control of {name} limits "
                    "its current anyway (i_limit), expected less",
                )

    def build(self, net: Network, ship: Any) -> None:
        """Put a limiter before every drive."""
        sources = [*ship.items("bess"), *ship.items("rectifier")]
        numbers = {number: name for number, name in enumerate(sources, 1)}
        for name, item in ship.items("propulsion").items():
            heaviest: dict[str, str | float] = {"loading": NOBODY, "capacity": 1.0, "which": 0.0}
            for number, source in numbers.items():
                for k, joined in enumerate(_paths(net, ship, item.bus, ship.item(source).bus, name)):
                    path = f"{name}.load_limit.{source}" + (f"_{k}" if k else "")
                    link, inputs = self._link(ship, source, number)
                    net.add(path, link, inputs=inputs | heaviest | {"joined": joined}, clock=Every(T_MARINE))
                    heaviest = {field: f"{path}.{field}" for field in heaviest}
            own = f"{name}.load_limit"
            granted = net.reconnect(f"{name}.speed", share=f"{own}.share")["share"]
            speed_ref = net.reconnect(f"{name}.cruise", speed_ref=f"{own}.speed_ref")["speed_ref"]
            net.add(
                own,
                LoadLimit(rating=item.rating, tau_max=item.speed.tau_max, T_cut=self.response),
                inputs={
                    **heaviest,
                    "granted": granted,
                    "speed_ref": speed_ref,
                    "u_ship": "hull.surge.u_ship",
                    "omega_pu": f"{name}.shaft.omega_pu",
                    "tau_ref": f"{name}.speed.tau_ref",
                    "torque_limited": f"{name}.speed.torque_limited",
                },
                clock=Every(T_MARINE),
            )
            texts = {0: f"{name} free again"}
            texts |= {number: f"{name} cut back for {source}" for number, source in numbers.items()}
            net.watch_state(self.name, f"{own}.cause", states=texts)
            net.publish(
                f"{name}.p_limit", source=f"{own}.p_limit", unit="W", description="power the sources allow the drive"
            )

    def _link(self, ship: Any, source: str, number: int) -> tuple[SourceLoad, dict[str, str | float]]:
        item = ship.item(source)
        if source in ship.items("bess"):
            i_most = self.battery * item.i_n
            link = SourceLoad(number=number, capacity=i_most * item.v_n, i_most=i_most)
            return link, {"i_star": f"{source}.control.i_star", "mode": f"{source}.control.mode"}
        genset = ship.item(item.source)
        link = SourceLoad(number=number, capacity=self.genset * genset.rating, p_most=self.genset)
        return link, {"p": f"{item.source}.machine.p_pu", "connected": f"{source}.sequence.enable"}


def _paths(net: Network, ship: Any, bus: str, end: str, owner: str) -> list[str | float]:
    """Signals that are 1 while one way over ties from a bus to another is closed: one for each way."""
    if bus == end:
        return [1.0]
    found: list[str | float] = []
    for ties in _ways(ship, bus, end, ()):
        before: str | float = f"{ties[0]}.sequence.closed"
        for k, tie in enumerate(ties[1:], 1):
            path = f"{owner}.load_limit.way_" + "_".join(ties[: k + 1])
            if path not in net.placed:
                inputs = {"before": before, "closed": f"{tie}.sequence.closed"}
                net.add(path, TiePath(), inputs=inputs, clock=Every(T_MARINE))
            before = f"{path}.joined"
        found.append(before)
    return found


def _ways(ship: Any, bus: str, end: str, passed: tuple[str, ...]) -> Iterator[tuple[str, ...]]:
    """Ties on each way from a bus to another that passes none twice."""
    if bus == end:
        yield ()
        return
    for name, tie in ship.items("dc_breaker").items():
        other = {tie.from_: tie.to, tie.to: tie.from_}.get(bus)
        if other is not None and other not in passed:
            for rest in _ways(ship, other, end, (*passed, bus)):
                yield (name, *rest)


@rule
class StartGensetOnLowSoc:
    """A genset is started when a battery is low, and stopped when all are charged."""

    name: ClassVar = "start_genset_on_low_soc"

    below: Ratio = param(
        "state of charge of a battery that starts it",
        default=0.3,
        above=0.0,
        below=1.0,
        source="0.1 above the batteries' own limit",
    )
    until: Ratio = param(
        "state of charge of all that ends it",
        default=0.5,
        above=0.0,
        below=1.0,
        source="[DAgostino2020] sec. 6.3: where a mission starts",
    )
    recharge: Ampere = param(
        "current at which each battery is charged", default=64.0, above=0.0, source="half the rated current"
    )
    genset: str = reference("genset to start; the first of the ship if left out", "genset", default="")

    def check(self, ship: Any) -> Iterator[tuple[str, str]]:
        """What is wrong with it for a ship: key (or nothing) and text."""
        if self.below >= self.until:
            yield "until", f"{self.until:g} is not above the {self.below:g} at which it starts (below), expected more"
        if not ship.items("bess") or not ship.items("genset"):
            yield "", f"the ship has no {'genset' if ship.items('bess') else 'battery'}, expected both"
        elif self.genset and self.genset not in ship.items("genset"):
            yield "genset", f"there is no genset '{self.genset}', expected one of {', '.join(ship.items('genset'))}"
        for name, item in ship.items("bess").items():
            if self.below <= item.soc_min + item.soc_fade:
                yield (
                    "below",
                    f"{self.below:g} is where {name} gives no full current any more (its soc_min {item.soc_min:g} and "
                    f"soc_fade {item.soc_fade:g}): the genset would come too late, expected more",
                )
            if self.until >= item.soc_max - item.soc_fade:
                yield (
                    "until",
                    f"{self.until:g} is where {name} takes no full current any more (its soc_max {item.soc_max:g} and "
                    f"soc_fade {item.soc_fade:g}): it would never end, expected less",
                )
            low = -ship.commands[f"{name}.i_ref"].low
            if self.recharge > low:
                yield "recharge", f"{self.recharge:g} A is more than {name} can be told ({low:g} A), expected less"


RULES: dict[str, type] = {cls.name: cls for cls in (BlackoutPrevention, StartGensetOnLowSoc)}
"""What a scenario's `rules` may have, by name."""


class Order(NamedTuple):
    """Commands that a rule gives, and why."""

    commands: dict[str, float]
    why: str


WATCHING, STARTING, CHARGING, LET_GO = "watching", "starting", "charging", "let go"


class LowSocOperator:
    """What `StartGensetOnLowSoc` does, every time it looks.

    Parameters
    ----------
    rule : StartGensetOnLowSoc
    ship : Ship
    plan : Plan
        Of that ship: where its signals are.
    """

    def __init__(self, rule: StartGensetOnLowSoc, ship: Any, plan: Any):
        self.rule, self.ship, self.index = rule, ship, plan.layout.index
        self.gensets = sorted(ship.items("genset"), key=lambda name: name != rule.genset)
        self.rectifiers = {item.source: name for name, item in ship.items("rectifier").items()}
        self.state: dict[str, Any] = {"doing": WATCHING, "genset": 0, "before": {}}
        """What it does, which genset it has taken, the set points that it has found; all that it remembers."""

    def look(self, sig: Any) -> Order | None:
        """What it commands now, if anything."""
        soc = {name: self._now(sig, f"{name}.battery.soc") for name in self.ship.items("bess")}
        lowest = min(soc, key=soc.__getitem__)
        said = f"{lowest} at {100.0 * soc[lowest]:.1f} %"
        doing, charged = self.state["doing"], soc[lowest] >= self.rule.until
        if doing == LET_GO:
            self._go_on(WATCHING if charged else LET_GO)
        elif doing == WATCHING:
            off = not any(self._command(sig, f"{name}.on") for name in self.gensets)
            return self._start(0, {}, said) if soc[lowest] < self.rule.below and off else None
        elif self._overruled(sig):
            self._go_on(LET_GO)
        elif doing == CHARGING and charged:
            given = {**self.state["before"], f"{self.genset}.on": 0.0}
            self._go_on(WATCHING)
            return Order(given, said)
        elif doing == STARTING:
            return self._wait_for(sig, list(soc))
        return None

    @property
    def genset(self) -> str:
        """The genset that it has taken."""
        return self.gensets[self.state["genset"]]

    def _start(self, number: int, first: dict[str, float], why: str) -> Order:
        self._go_on(STARTING, genset=number)
        return Order({**first, f"{self.genset}.on": 1.0}, why)

    def _wait_for(self, sig: Any, batteries: list[str]) -> Order | None:
        """Recharge once the genset is connected; the next one if it refuses."""
        sequences = f"{self.genset}.sequence", f"{self.rectifiers[self.genset]}.sequence"
        if any(self._now(sig, f"{sequence}.refused") for sequence in sequences):
            stop, why, number = {f"{self.genset}.on": 0.0}, f"{self.genset} did not start", self.state["genset"] + 1
            if number < len(self.gensets):
                return self._start(number, stop, why)
            self._go_on(LET_GO)
            return Order(stop, why)
        if self._now(sig, f"{sequences[1]}.state") != rectifier.CONNECTED:
            return None
        paths = [f"{name}.i_ref" for name in batteries if self._in_droop(sig, name)]
        self._go_on(CHARGING, before={path: self._command(sig, path) for path in paths})
        return Order(dict.fromkeys(paths, -self.rule.recharge), f"{self.genset} is connected")

    def _overruled(self, sig: Any) -> bool:
        """Whether somebody has given one of its commands another value; one that is held back has its old one."""
        if not self._command(sig, f"{self.genset}.on"):
            return True
        return any(
            self._command(sig, path) not in (-self.rule.recharge, old) for path, old in self.state["before"].items()
        )

    def _go_on(self, doing: str, **others: Any) -> None:
        kept = {"genset": self.state["genset"], "before": {}}
        self.state = {"doing": doing, **kept, **others}

    def _now(self, sig: Any, path: str) -> float:
        return float(sig[self.index[path]])

    def _command(self, sig: Any, path: str) -> float:
        return self._now(sig, f"command:{path}")

    def _in_droop(self, sig: Any, name: str) -> bool:
        on = self._now(sig, f"{name}.sequence.state") in (bess.RAMP_IN, bess.ON)
        return on and self._command(sig, f"{name}.mode") == DROOP


def equip(net: Network, ship: Any, rules: Iterable[Any]) -> None:
    """Build into a ship's network what the rules need in the plant."""
    for rule in rules:
        if isinstance(rule, BlackoutPrevention):
            rule.build(net, ship)


def operator_of(rules: Iterable[Any], ship: Any, plan: Any) -> LowSocOperator | None:
    """Who gives commands by the rules, if anybody does."""
    return next((LowSocOperator(rule, ship, plan) for rule in rules if isinstance(rule, StartGensetOnLowSoc)), None)
