"""The gateway of a live run to field buses: its options, where it listens, and what was counted."""

from __future__ import annotations

import ipaddress
import os
import socket
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import typer

from shipgrid.cli.options import quantity_of_option

if TYPE_CHECKING:
    from shipgrid.realtime.gateway import Gateway

TOKEN = "SHIPGRID_TOKEN"
"""Variable of the environment with the token that controllers need."""


def gateway_of_options(buses: Mapping[str, str | None], on_loss: str, timeout: str) -> Gateway | None:
    """The gateway that is asked for, if any; that it listens where others can reach it goes to the error stream.

    Parameters
    ----------
    buses : mapping of str to str
        `HOST:PORT` by "udp" and "modbus"; None where the option is not given.
    on_loss : {"hold", "safe", "local"}
        What becomes of the commands of a lost controller.
    timeout : str
        Silence after which a controller is lost, such as "500ms".

    Raises
    ------
    InputErrors
        With every mistake in these options and in the token of the environment.
    """
    from shipgrid.errors import InputErrors
    from shipgrid.realtime.desk import LOST
    from shipgrid.realtime.gateway import Gateway

    problems: list[str] = []
    if on_loss not in LOST:
        problems.append(f"--on-loss: nothing is done by the name '{on_loss}', expected {', '.join(LOST)}")
    seconds = 0.0
    try:
        seconds = quantity_of_option("--timeout", timeout, "s") or 0.0
        if seconds <= 0.0:
            problems.append(f"--timeout: {timeout} is no time to wait, expected more than 0 s")
    except InputErrors as wrong:
        problems += wrong.problems
    places = {name: _address(f"--{name}", text, problems) for name, text in buses.items() if text is not None}
    digits = os.environ.get(TOKEN, "") if places else ""
    if digits and (len(digits) != 16 or not set(digits.lower()) <= set("0123456789abcdef")):
        problems.append(f"{TOKEN}: is no token, expected 16 hexadecimal digits")
    if problems:
        raise InputErrors(problems)
    if not places:
        return None
    for name, address in places.items():
        if address is not None and not ipaddress.ip_address(address[0]).is_loopback:
            warning = (
                f"--{name}: listens on {address[0]}, which other machines may reach; the token goes there unencrypted"
            )
            typer.echo(warning, err=True)
    gateway = Gateway(places.get("udp"), places.get("modbus"), on_loss, seconds)
    if digits:
        gateway.token = int(digits, 16)
    else:
        typer.echo(f"token of this run: {gateway.token:016x} (or set {TOKEN})", err=True)
    return gateway


def _address(option: str, text: str, problems: list[str]) -> tuple[str, int] | None:
    """Address in numbers and port of `HOST:PORT`, `[::1]:502`; None, and a problem more, if it is none."""
    host, colon, port = text.rpartition(":")
    bracketed = host.startswith("[") and host.endswith("]")
    expected = "expected HOST:PORT, such as 127.0.0.1:5020 or [::1]:5020"
    if not colon or not host or (":" in host and not bracketed):
        problems.append(f"{option}: '{text}' is no address, {expected}")
    elif not (port.isascii() and port.isdecimal()) or int(port) > 65535:
        problems.append(f"{option}: '{port}' is no port, expected 0 to 65535 (0: any that is free)")
    else:
        try:
            found = socket.getaddrinfo(host.strip("[]") if bracketed else host, int(port), type=socket.SOCK_STREAM)
            return str(found[0][4][0]), int(port)
        except (OSError, UnicodeError) as wrong:
            problems.append(f"{option}: there is no host '{host}' ({wrong}), {expected}")
    return None


def start_gateway(gateway: Gateway, shared: Any, run: Any) -> Callable[[], dict[str, Any]]:
    """Start the gateway with the run, and print where it listens and what the registers are.

    Parameters
    ----------
    gateway : Gateway
    shared : Any
        What the steps of the run share with the gateway.
    run : Any
        The run that begins.

    Returns
    -------
    callable
        Ends the gateway and returns what `print_gateway` prints.
    """
    end = gateway.start(shared, run)
    for bus, (host, port) in gateway.listening.items():
        typer.echo(f"{bus} on {f'[{host}]' if ':' in host else host}:{port}", err=True)
    typer.echo(f"registers in {run.folder / 'registers.csv'}", err=True)
    return end


def print_gateway(counts: Mapping[str, Any]) -> None:
    """Print how many messages came and went, and what failed.

    Parameters
    ----------
    counts : mapping of str to Any
        By what is counted; besides them `listening`, `on_loss` and `failure`.
    """
    counted = {what: count for what, count in counts.items() if what not in ("listening", "on_loss", "failure")}
    text = ", ".join(f"{count} {what}" for what, count in sorted(counted.items())) or "nobody called"
    typer.echo(f"gateway: {text}")
    if counts["failure"]:
        typer.echo(f"{counts['failure']}; commands were held, and the run went on without it", err=True)
