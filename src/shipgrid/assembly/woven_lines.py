"""Lines of woven functions that all kinds of components share: inputs handed over, arguments, loops over instances."""

from __future__ import annotations

from typing import Any

from shipgrid.model.kernel import argument_names


def pass_to(kernel: Any, key: str, **values: str) -> str:
    """Arguments of a call of a component's kernel, for instance `i` of its type.

    Parameters
    ----------
    kernel : function
    key : str
        Of the type.
    values : str
        What stands for arguments that depend on where it is called.

    Raises
    ------
    TypeError
        If it has an argument that nothing stands for.
    """
    function = getattr(kernel, "py_func", kernel)
    given = {
        "t": "t",
        "tables": "tables",
        "delays": "delays",
        "x": f"{key}_x[i]",
        "u": f"{key}_u[i]",
        "y": f"{key}_y[i]",
        "p": f"{key}_p[i]",
        "n": f"{key}_n[i]",
        "gh": "gh",
    } | values
    names = argument_names(kernel)
    missing = [name for name in names if name not in given]
    if missing:
        raise TypeError(f"kernel {function.__module__}.{function.__name__} asks for unknown arguments {missing}")
    return ", ".join(given[name] for name in names)


def gather_lines(key: str, at: str, wrap: str = "") -> list[str]:
    """Lines that hand an instance its inputs: all as they are now, or what is measured at another time.

    Parameters
    ----------
    key : str
        Of the type.
    at : {"now", "sampled", "ahead"}
        Sampled: at the fraction `f` of the last step. Ahead: what is smooth carried on by the share `part` of a step.
    wrap : str
        Name of the kernel that brings an angle into -pi .. pi: it goes the short way round.
    """
    now = [
        f"for j in range({key}_now_start[i], {key}_now_start[i + 1]):",
        f"    sig[{key}_now[j, 0]] = sig[{key}_now[j, 1]]",
    ]
    if at == "now":
        return now
    latest = [
        f"for j in range({key}_latest_start[i], {key}_latest_start[i + 1]):",
        f"    sig[{key}_latest[j, 0]] = sig[{key}_latest[j, 1]]",
    ]
    if at == "ahead":
        return [
            *latest,
            f"for j in range({key}_measured_start[i], {key}_measured_smooth[i]):",
            f"    sig[{key}_measured[j, 0]] = sig[{key}_measured[j, 1]]",
            f"for j in range({key}_measured_smooth[i], {key}_measured_turn[i]):",
            f"    a = sig[{key}_measured[j, 1]]",
            f"    sig[{key}_measured[j, 0]] = a + part * (a - previous[{key}_measured[j, 1]])",
            f"for j in range({key}_measured_turn[i], {key}_measured_start[i + 1]):",
            f"    a = sig[{key}_measured[j, 1]]",
            f"    sig[{key}_measured[j, 0]] = {wrap}(a + part * {wrap}(a - previous[{key}_measured[j, 1]]))",
        ]
    between = [
        *latest,
        f"for j in range({key}_measured_start[i], {key}_measured_turn[i]):",
        f"    b = previous[{key}_measured[j, 1]]",
        f"    a = sig[{key}_measured[j, 1]]",
        f"    sig[{key}_measured[j, 0]] = b + f * (a - b) + lead[{key}_measured_lead[j]]",
        f"for j in range({key}_measured_turn[i], {key}_measured_start[i + 1]):",
        f"    b = previous[{key}_measured[j, 1]]",
        f"    a = sig[{key}_measured[j, 1]]",
        f"    sig[{key}_measured[j, 0]] = {wrap}(b + f * {wrap}(a - b))",
    ]
    return ["if f == 1.0:", *(f"    {line}" for line in now), "else:", *(f"    {line}" for line in between)]


def copy_lines(key: str, to: str, origin: str) -> list[str]:
    """Lines that copy one of an instance's state records to another."""
    return [f"for j in range({key}_xf.shape[1]):", f"    {key}_{to}f[i, j] = {key}_{origin}f[i, j]"]


def for_all(key: str, lines: list[str]) -> list[str]:
    """Lines for each instance of a type of which all run in every step."""
    return [f"for i in range({key}_clock.shape[0]):", *(f"    {line}" for line in lines)]


def where_due(key: str, lines: list[str]) -> list[str]:
    """Lines for each instance of a type whose clock struck, at the fraction `f` of the last step."""
    guarded = [f"c = {key}_clock[i]", "f = clock_before[c]", "if f >= 0.0:", *(f"    {line}" for line in lines)]
    return [f"for i in range({key}_clock.shape[0]):", *(f"    {line}" for line in guarded)]
