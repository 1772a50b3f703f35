"""The one door to the compiler.

`error_model="numpy"` makes a division by zero inf or NaN, which the step's status check reports, instead of a
branch at every division; `fastmath` stays off so that sums keep their order and two machines agree. Kernels are
never cached on disk; only the entry point of a woven module is (docs/decisions/0002-woven-module.md).

`_nrt=False` compiles without reference counts: a kernel that would allocate does not compile, and views of the flat
vector are passed on without the atomic increments that cost a step of the ferry several microseconds.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from types import FunctionType
from typing import Any, TypeVar

from numba import config, njit
from numba.core.dispatcher import Dispatcher

# Loops here are over two or three instances: vectorised copies of them are an eighth of the compile time and no faster.
config.LOOP_VECTORIZE = 0  # pyright: ignore[reportAttributeAccessIssue]

Function = TypeVar("Function", bound=Callable[..., object])

OPTIONS: dict[str, Any] = {"error_model": "numpy", "fastmath": False, "_nrt": False}


def kernel(function: Function) -> Dispatcher[Function]:
    """Compile a `function` of records and numbers, when it is first called; `kernel(f).py_func` is what was written."""
    return njit(**OPTIONS)(function)


def entry_point(function: Function) -> Dispatcher[Function]:
    """Compile the `function` by which a woven module is entered; its machine code is kept on disk."""
    return njit(cache=True, nogil=True, **OPTIONS)(function)


@cache
def uncompiled(function: Callable[..., Any]) -> FunctionType:
    """The plain Python function behind a kernel, the kernels it calls plain as well.

    For what runs once (matrices, start values, derivatives by complex step): a kernel called from Python would be
    compiled for each new type of argument, which takes longer than the call.
    """
    plain = getattr(function, "py_func", function)
    scope = dict(plain.__globals__)
    for name in plain.__code__.co_names:
        if isinstance(scope.get(name), Dispatcher):
            scope[name] = uncompiled(scope[name])
    return FunctionType(plain.__code__, scope, plain.__name__, plain.__defaults__, plain.__closure__)


def argument_names(function: Callable[..., Any]) -> tuple[str, ...]:
    """Names of the arguments of a kernel: what it is handed."""
    code = getattr(function, "py_func", function).__code__
    return code.co_varnames[: code.co_argcount]


def call_uncompiled(function: Callable[..., Any], values: Mapping[str, Any]) -> Any:
    """Call a kernel as plain Python with those of `values` that it asks for."""
    return uncompiled(function)(*[values[name] for name in argument_names(function)])
