"""Digest of everything that a compiled function can depend on: its own code, and all that it reaches by name.

Functions enter with their code, constants with their value: an edit of a comment changes nothing, an edit of a helper
three modules away does. What is neither (an intrinsic, a class) enters with the source of its module.
"""

from __future__ import annotations

import hashlib
import importlib.util
import inspect
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from types import BuiltinFunctionType, CodeType, FunctionType, ModuleType
from typing import Any

import llvmlite
import numba
import numpy as np
from numba import config
from numba.core.dispatcher import Dispatcher

COMPILER = "shipgrid.model.kernel"
OUTSIDE = frozenset(("numpy", "math", "numba", "llvmlite", "builtins", "cmath"))
"""Packages that are covered by their version."""

DISABLED = bool(config.DISABLE_JIT)  # pyright: ignore[reportAttributeAccessIssue]

HAS_DOCSTRING = 0x4000000
"""Flag of a function's code, from Python 3.13 on; before, a text as its first constant is its docstring."""


@cache
def versions() -> str:
    """What the same source compiles differently under."""
    found = [sys.version, numba.__version__, llvmlite.__version__, np.__version__, sys.platform]
    return "\n".join([*found, _source_digest(COMPILER)])


def fingerprint(*functions: Callable[..., Any]) -> str:
    """Digest of functions and all that they reach.

    Parameters
    ----------
    functions : function
        Plain, or kernels.
    """
    digest = hashlib.sha256()
    for name, content in sorted(reached(*functions).items()):
        digest.update(f"{name}\0{content}\0".encode())
    return digest.hexdigest()


def reached(*functions: Callable[..., Any]) -> dict[str, str]:
    """What functions reach, by name: a digest of the code of a function, a constant's value, a module's source.

    Parameters
    ----------
    functions : function
    """
    found: dict[str, str] = {}
    for function in functions:
        _visit(function, found)
    return found


def _visit(value: Any, found: dict[str, str], called: str = "") -> None:
    plain = getattr(value, "py_func", value) if isinstance(value, Dispatcher) else value
    if isinstance(plain, FunctionType):
        if plain.__module__.partition(".")[0] in OUTSIDE:
            return
        name = f"{plain.__module__}.{plain.__qualname__}"
        if name in found:
            return
        found[name] = _code_digest(plain.__code__) + repr((plain.__defaults__, plain.__kwdefaults__))
        if called and value is plain and not DISABLED:  # a kernel calls it: what stands for it is in its module
            _visit_module(plain.__module__, found)
        for cell, variable in zip(plain.__closure__ or (), plain.__code__.co_freevars, strict=True):
            _visit(cell.cell_contents, found, f"{name}.{variable}")
        for code in _codes(plain.__code__):
            _visit_names(code, plain.__globals__, found, name)
    elif isinstance(value, ModuleType | BuiltinFunctionType | np.ufunc | type(None)):
        return
    elif isinstance(value, bool | int | float | complex | str | bytes | np.generic):
        found[called] = repr(value)
    elif isinstance(value, np.ndarray):
        found[called] = hashlib.sha256(value.tobytes()).hexdigest() + repr((value.dtype, value.shape))
    elif isinstance(value, tuple | list | frozenset):
        found[called] = type(value).__name__
        for k, item in enumerate(sorted(value, key=repr) if isinstance(value, frozenset) else value):
            _visit(item, found, f"{called}[{k}]")
    else:
        _visit_module(getattr(value, "__module__", None) or type(value).__module__, found)


def _visit_module(name: str, found: dict[str, str]) -> None:
    if name.partition(".")[0] not in OUTSIDE and name != COMPILER:
        found[f"module {name}"] = _source_digest(name)


def _visit_names(code: CodeType, scope: dict[str, Any], found: dict[str, str], asker: str) -> None:
    """All global names of a function; of a module among them, the names that are taken from it."""
    for name in code.co_names:
        if name not in scope:
            continue
        value = scope[name]
        if isinstance(value, ModuleType):
            if value.__name__.partition(".")[0] not in OUTSIDE:
                for attribute in (a for a in code.co_names if hasattr(value, a)):
                    _visit(getattr(value, attribute), found, f"{value.__name__}.{attribute}")
            continue
        _visit(value, found, f"{asker}: {name}")


def _codes(code: CodeType) -> list[CodeType]:
    """A function's code, and that of the functions inside it."""
    inner = [c for c in code.co_consts if isinstance(c, CodeType)]
    return [code, *(found for c in inner for found in _codes(c))]


def _code_digest(code: CodeType) -> str:
    """Digest of what a function does: not of where it stands, and not of its docstring."""
    digest = hashlib.sha256()
    for part in _codes(code):
        first = part.co_consts[0] if part.co_consts else None
        documented = isinstance(first, str) and (sys.version_info < (3, 13) or part.co_flags & HAS_DOCSTRING)
        loaded = [c for c in part.co_consts if not isinstance(c, CodeType)][1 if documented else 0 :]
        constants = [sorted(map(repr, c)) if isinstance(c, frozenset) else repr(c) for c in loaded]
        names = part.co_names, part.co_varnames, part.co_freevars, part.co_cellvars, part.co_argcount
        digest.update(repr((part.co_code, constants, names)).encode())
    return digest.hexdigest()


@cache
def _source_digest(module: str) -> str:
    spec = importlib.util.find_spec(module) if module != "__main__" else None
    path = spec.origin if spec is not None and spec.has_location else None
    if path is None:
        known = sys.modules.get(module)
        try:
            return hashlib.sha256(inspect.getsource(known).encode()).hexdigest() if known else "unknown"
        except OSError:
            return "unknown"
    return hashlib.sha256(Path(path).read_bytes()).hexdigest()
