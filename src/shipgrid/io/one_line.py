"""The one-line diagram of a ship file as an SVG drawing.

Sources stand above the DC bus they feed, loads below it, each AC bar below the inverters that feed it, ties between
the buses. Placement follows from what each item refers to, so that any ship file gets a diagram; a kind without a
symbol of its own is a box with the kind's name in it. Colours come from the page's style sheet.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from html import escape
from importlib.resources import files
from typing import Any

SLOT = 150
"""Width of one item with its label [px]."""
ROWS = {"source": 46, "converter": 128, "dc": 196, "drive": 262, "end": 338, "ac": 338, "load": 404}
"""Height of each row of the drawing [px], from the top."""
HEIGHT = 444
TIE_GAP = 96
FIRST_SYMBOL = 30

SQUARE = '<rect class="body" x="-18" y="-18" width="36" height="36"/><path class="thin" d="M-18,18L18,-18"/>'
WAVE_IN, WAVE_OUT = '<path class="thin" d="M-14,-8q3,-5 6,0t6,0"/>', '<path class="thin" d="M2,9q3,-5 6,0t6,0"/>'
DIRECT_IN, DIRECT_OUT = '<text class="small" x="-8" y="-5">=</text>', '<text class="small" x="8" y="12">=</text>'
MACHINE = (
    '<circle class="body" r="18"/><text class="letter" y="-1">{}</text><path class="thin" d="M-8,8q4,-6 8,0t8,0"/>'
)
SHORE = '<circle class="body" cx="-6" r="11"/><circle class="body" cx="6" r="11"/><path class="thin" d="M17,-9V9"/>'
SYMBOLS = {
    "genset": MACHINE.format("G"),
    "propulsion": MACHINE.format("M"),
    "ac_motor": MACHINE.format("M"),
    "shore_connection": SHORE,
    "rectifier": SQUARE + WAVE_IN + DIRECT_OUT,
    "bess": SQUARE + DIRECT_IN + DIRECT_OUT,
    "inverter": SQUARE + DIRECT_IN + WAVE_OUT,
}
BATTERY = (
    '<rect class="body" x="-11" y="-15" width="22" height="31" rx="3"/>'
    '<path class="wire" d="M-4,-18.5H4M0,-9V-1M-4,-5H4M-4,9H4"/>'
)
LOAD = '<path class="body" d="M-9,-10H9L0,8Z"/>'
PROPELLER = (
    '<ellipse class="body" cx="-8" rx="8" ry="4.5"/><ellipse class="body" cx="8" rx="8" ry="4.5"/>'
    '<circle class="body" r="2"/>'
)
BOX = '<rect class="body" x="-18" y="-14" width="36" height="28"/><text class="small" y="3">{}</text>'
BREAKER = '<rect class="body" x="-9" y="-9" width="18" height="18"/><path class="thin" d="M-9,-9L9,9M-9,9L9,-9"/>'
RATINGS = ("rating", "capacity", "p", "v_n")


@dataclass
class Stack:
    """Items under or over one point of a DC bus: what hangs there, and how many slots it takes."""

    name: str
    kind: str
    width: int = 1
    bar: str | None = None
    loads: list[str] = field(default_factory=list)


def style_by_itself() -> str:
    """Rules for a drawing outside of a report: those of its style sheet, in the colours of the page it is on."""
    sheet = files("shipgrid.io").joinpath("static/report.css").read_text()
    rules = [line for line in sheet.splitlines() if line.startswith(".one-line")]
    colours = "--paper: transparent; --ink: currentColor; --quiet: gray; --c0: #0072b2; --c1: #d55e00"
    return "\n".join([f".one-line {{ {colours} }}", *rules])


def one_line(ship: Mapping[str, Any]) -> str:
    """Draw the one-line diagram of a ship.

    Parameters
    ----------
    ship : mapping
        A ship file's contents: `buses` {name: {kind, ...}} and `equipment` {name: {kind, ...}}.

    Returns
    -------
    str
        An `<svg>` element; empty if the ship has no buses.
    """
    buses = ship.get("buses") or {}
    if not buses:
        return ""
    return Drawing(buses, ship.get("equipment") or {}).svg()


class Drawing:
    """One diagram being drawn.

    Parameters
    ----------
    buses, equipment : mapping
        As in the ship file.
    """

    def __init__(self, buses: Mapping[str, Mapping], equipment: Mapping[str, Mapping]):
        self.buses, self.equipment = buses, equipment
        self.parts: list[str] = []
        self.rails: list[str] = []
        self.bars: dict[str, tuple[float, float, float]] = {}
        self.fed_by_rectifier = {item.get("source") for item in equipment.values() if item.get("source")}

    def svg(self) -> str:
        """Lay everything out from left to right, and return the drawing."""
        x = 10.0
        for index, (name, bus) in enumerate(self.buses.items()):
            if bus.get("kind") != "dc":
                continue
            width = self._side(name, x, index)
            x += width + TIE_GAP
        for name, bus in self.buses.items():  # an AC bus that no inverter feeds: shore, or generators in parallel
            if name not in self.bars and bus.get("kind") == "ac":
                x += self._lone_bar(name, x) + TIE_GAP
        for name, item in self.equipment.items():
            if {"from", "to"} <= set(item):
                self._tie(name, str(item["from"]), str(item["to"]))
        width = max(x - TIE_GAP + 10.0, 200.0)
        body = "".join(self.parts + self.rails)
        size = f'viewBox="0 0 {width:g} {HEIGHT}" style="max-width:{width:g}px"'
        return f'<svg class="one-line" {size} role="img" aria-label="one-line diagram">{body}</svg>'

    def _stacks(self, bus: str) -> tuple[list[Stack], list[Stack]]:
        """What stands above, and what hangs below a DC bus."""
        above, below = [], []
        for name, item in self.equipment.items():
            kind = str(item.get("kind", ""))
            if item.get("bus") != bus or name in self.fed_by_rectifier or {"from", "to"} <= set(item):
                continue
            if kind in ("rectifier", "bess", "genset", "shore"):
                above.append(Stack(name, kind))
                continue
            stack = Stack(name, kind)
            bar = str(item.get("grid", ""))
            if bar in self.buses and bar not in self.bars:
                stack.bar, stack.loads = bar, list(self._on_bar(bar))
                stack.width = max(1, len(stack.loads))
                self.bars[bar] = (0.0, 0.0, 0.0)
            below.append(stack)
        return above, below

    def _on_bar(self, bar: str) -> Iterator[str]:
        return (name for name, item in self.equipment.items() if item.get("bus") == bar)

    def _side(self, bus: str, x: float, index: int) -> float:
        """Draw one DC bus with everything on it; return its width."""
        above, below = self._stacks(bus)
        if index:  # the first side is mirrored, so that the AC bars of two sides face each other
            below.sort(key=lambda stack: stack.bar is None)
        else:
            below.sort(key=lambda stack: stack.bar is not None)
        width = SLOT * max(len(above), sum(s.width for s in below), 1)
        y = ROWS["dc"]
        self.bars[bus] = (x, x + width, y)
        self._bar(bus, x, x + width, y)
        for k, stack in enumerate(above):
            self._above(stack, x + k * SLOT + FIRST_SYMBOL)
        at = x
        for stack in below:
            self._below(stack, at)
            at += stack.width * SLOT
        return width

    def _above(self, stack: Stack, x: float) -> None:
        y = ROWS["converter"]
        self._wire(x, y + 18, ROWS["dc"])
        self._symbol(stack.kind, stack.name, x, y)
        source = str(self.equipment[stack.name].get("source", ""))
        if source in self.equipment:
            self._wire(x, ROWS["source"] + 18, y - 18)
            self._symbol(str(self.equipment[source].get("kind", "")), source, x, ROWS["source"])
        elif stack.kind == "bess":
            self._wire(x, ROWS["source"] + 16, y - 18)
            self._shape(BATTERY, x, ROWS["source"])

    def _below(self, stack: Stack, left: float) -> None:
        x, y = left + FIRST_SYMBOL, ROWS["drive"]
        self._wire(x, ROWS["dc"], y - 18)
        if stack.kind == "propulsion":
            self._shape(SYMBOLS["inverter"], x, y)
            self._wire(x, y + 18, ROWS["end"] - 18)
            self._symbol("propulsion", stack.name, x, ROWS["end"])
            self._wire(x, ROWS["end"] + 18, ROWS["load"] - 6)
            self._shape(PROPELLER, x, ROWS["load"])
            self._label(str(self.equipment[stack.name].get("propeller", "")), "", x, ROWS["load"])
            return
        self._symbol(stack.kind, stack.name, x, y)
        if stack.bar is not None:
            self._wire(x, y + 18, ROWS["ac"])
            self._loads(stack.bar, stack.loads, left, stack.width)

    def _loads(self, bar: str, loads: list[str], left: float, width: int) -> None:
        """Draw an AC bar with its loads."""
        y = ROWS["ac"]
        self.bars[bar] = (left, left + width * SLOT - 20, y)
        self._bar(bar, *self.bars[bar])
        for k, name in enumerate(loads):
            x = left + k * SLOT + FIRST_SYMBOL
            self._wire(x, y, ROWS["load"] - 10)
            self._symbol(str(self.equipment[name].get("kind", "")), name, x, ROWS["load"])

    def _lone_bar(self, bar: str, x: float) -> float:
        loads = [n for n in self._on_bar(bar) if n not in self.fed_by_rectifier]
        self._loads(bar, loads, x, max(1, len(loads)))
        return max(1, len(loads)) * SLOT

    def _tie(self, name: str, first: str, second: str) -> None:
        """Draw a breaker between two buses; on the level of both, or as an arc where they are not alike."""
        if first not in self.bars or second not in self.bars:
            return
        (a, b) = sorted((self.bars[first], self.bars[second]))
        x1, x2, y1, y2 = a[1], b[0], a[2], b[2]
        x, y = (x1 + x2) / 2, (y1 + y2) / 2
        self.parts.append(f'<path class="wire" d="M{x1:g},{y1:g}L{x:g},{y:g}L{x2:g},{y2:g}"/>')
        self._shape(BREAKER, x, y)
        self.parts.append(f'<text class="name" text-anchor="middle" x="{x:g}" y="{y - 15:g}">{escape(name)}</text>')

    def _bar(self, name: str, x1: float, x2: float, y: float) -> None:
        bus = self.buses[name]
        kind = "dc" if bus.get("kind") == "dc" else "ac"
        self.rails.append(f'<path class="bus {kind}" d="M{x1:g},{y:g}H{x2:g}"/>')
        text = f'<tspan class="strong">{escape(name)}</tspan> {escape(str(bus.get("v_n", "")))}'
        self.parts.append(f'<text class="name" text-anchor="end" x="{x2:g}" y="{y - 8:g}">{text}</text>')

    def _symbol(self, kind: str, name: str, x: float, y: float) -> None:
        shape = SYMBOLS.get(kind) or (LOAD if kind.endswith("load") else "")
        if not shape:
            shape = BOX.format(escape(kind[:6]))
        self._shape(shape, x, y)
        item = self.equipment.get(name, {})
        self._label(name, next((str(item[key]) for key in RATINGS if key in item), ""), x, y)

    def _shape(self, shape: str, x: float, y: float) -> None:
        self.parts.append(f'<g transform="translate({x:g},{y:g})">{shape}</g>')

    def _label(self, name: str, rating: str, x: float, y: float) -> None:
        self.parts.append(
            f'<text class="name" x="{x + 25:g}" y="{y - 1:g}">{escape(name)}</text>'
            f'<text class="rating" x="{x + 25:g}" y="{y + 12:g}">{escape(rating)}</text>'
        )

    def _wire(self, x: float, y1: float, y2: float) -> None:
        self.parts.append(f'<path class="wire" d="M{x:g},{y1:g}V{y2:g}"/>')
