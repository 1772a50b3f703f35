"""The one door to the compiler: how kernels are compiled, and what they find beside their arguments.

`error_model="numpy"` makes a division by zero inf or NaN, which the step's status check reports, instead of a
branch at every division; `fastmath` stays off so that sums keep their order and two machines agree. Kernels are
never cached on disk; what is made of them is: units and the core (`assembly/object_code.py`).

`_nrt=False` compiles without reference counts: a kernel that would allocate does not compile, and views of the flat
vector are passed on without the atomic increments that cost a step of the ferry several microseconds. Nobody calls a
kernel as a C function: its wrapper for that is left out.
"""

from __future__ import annotations

import ctypes
import dis
import platform
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cache, partial
from itertools import chain
from types import FunctionType
from typing import Any, TypeVar

import numpy as np
from llvmlite import ir
from numba import config, njit, types
from numba.core import cgutils
from numba.core.dispatcher import Dispatcher
from numba.extending import intrinsic
from numba.np.arrayobj import make_array, populate_array
from numba.np.numpy_support import from_dtype

# Loops here are over two or three instances: vectorised copies of them are an eighth of the compile time and no faster.
config.LOOP_VECTORIZE = 0  # pyright: ignore[reportAttributeAccessIssue]

Function = TypeVar("Function", bound=Callable[..., object])

OPTIONS: dict[str, Any] = {"error_model": "numpy", "fastmath": False, "_nrt": False, "no_cfunc_wrapper": True}


def kernel(function: Function) -> Dispatcher[Function]:
    """Compile a `function` of records and numbers, when it is first called; `kernel(f).py_func` is what was written."""
    return njit(**OPTIONS)(function)


def inlined(function: Function) -> Dispatcher[Function]:
    """Compile a `function` into those that call it: one of the solver, which the core calls in one place.

    Its arrays are not passed on then, seven numbers each; a step of the ferry is a twelfth faster for it.
    """
    return njit(forceinline=True, **OPTIONS)(function)


PLACE = "i8" if config.DISABLE_JIT else "u8"  # pyright: ignore[reportAttributeAccessIssue]
"""Element type of arrays of places and counts, see `without_sign`."""


class ArrayTable:
    """Addresses and shapes of arrays, one after the other, by which a compiled function finds them; a row a part.

    An array as an argument is seven numbers, and they are passed on as often as functions nest: the hundreds of arrays
    of a ship took half of the compile time and an eighth of the step (docs/decisions/0002-woven-module.md).

    Parameters
    ----------
    rows : sequence of TableRow
    moved : sequence of mapping of str to ndarray
        For each of them the arrays that take the place of those it was made with.

    Attributes
    ----------
    numbers : list of ndarray
        The rows, of int64. The table keeps alive what they name.
    addresses : ndarray
        Where each begins.
    """

    def __init__(self, rows: Sequence[TableRow], moved: Sequence[Mapping[str, np.ndarray]]) -> None:
        self.numbers = [row.numbers(arrays) for row, arrays in zip(rows, moved, strict=True)]
        self.addresses = np.array([_address(numbers) for numbers in self.numbers], dtype=np.int64)
        self.kept = list(rows), list(moved)


class TableRow:
    """One row of an `ArrayTable`: made once, and used again with other arrays in the place of some.

    Of the hundreds of arrays of a ship most are the plan's own, or views of a few arrays of the workspace. To look all
    of them up takes some milliseconds, to replace those few a tenth of one; it is done at each return to Python.

    Parameters
    ----------
    arrays : mapping of str to ndarray
        All that the row names, in their order.
    moving : mapping of str to ndarray
        Arrays that others take the place of, some of `arrays` among them. What lies inside the memory of one goes with
        it; what bears the name of one has its shape, too.

    Attributes
    ----------
    places : dict of str to int
        Where the entry of each array begins.
    """

    def __init__(self, arrays: Mapping[str, np.ndarray], moving: Mapping[str, np.ndarray]) -> None:
        entries = [[_address(a), *a.shape] for a in _in_one_piece(arrays.values())]
        starts = np.cumsum([0, *map(len, entries)])[:-1].tolist()
        self.places = dict(zip(arrays, starts, strict=True))
        self.row = np.array(list(chain(*entries)), dtype=np.int64)
        self.names = list(moving)
        self.whole = [name for name in arrays if name in moving]
        spans = {name: range(_address(a), _address(a) + a.nbytes) for name, a in moving.items()}
        moves: dict[str, tuple[int, int, int]] = {}  # place of its address, which array it lies in, bytes from there
        for name, array in arrays.items():
            address = _address(array)
            owner = name if name in moving else next((n for n, span in spans.items() if address in span), None)
            if owner is not None:
                moves[name] = self.places[name], self.names.index(owner), address - spans[owner].start
        self.moves = np.array(list(moves.values()), dtype=np.int64).reshape(-1, 3).T
        shapes = [range(self.places[name] + 1, self.places[name] + 1 + arrays[name].ndim) for name in self.whole]
        self.shapes = np.array(list(chain(*shapes)), dtype=np.int64)
        self.kept = [array for name, array in arrays.items() if name not in moves]

    def numbers(self, moved: Mapping[str, np.ndarray]) -> np.ndarray:
        """The row with other arrays in the place of those it was made with.

        Parameters
        ----------
        moved : mapping of str to ndarray
            By the names that `moving` had.

        Raises
        ------
        ValueError
            If one of them does not lie in one piece, or they have another number of dimensions.
        """
        addresses = np.array([_address(a) for a in _in_one_piece(moved[name] for name in self.names)], dtype=np.int64)
        places, owner, offset = self.moves
        row = self.row.copy()
        row[places] = addresses[owner] + offset
        row[self.shapes] = list(chain(*(moved[name].shape for name in self.whole)))
        return row


def _address(array: np.ndarray) -> int:
    return array.__array_interface__["data"][0]


def _in_one_piece(arrays: Iterable[np.ndarray]) -> Iterator[np.ndarray]:
    """Arrays as they are, if each lies in one piece."""
    for array in arrays:
        if not array.flags.c_contiguous:
            raise ValueError("an array of a table must lie in one piece")
        yield array


CACHE_LINE = 64
"""What two cores cannot write into at a time [bytes]."""


def in_one_piece(arrays: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Copies of arrays, one after the other in memory that shares no cache line with anything else."""
    size = sum(-(-a.nbytes // 16) * 16 for a in arrays.values())
    memory = np.zeros(size + 2 * CACHE_LINE, dtype=np.uint8)
    at = -memory.ctypes.data % CACHE_LINE
    found = {}
    for name, a in arrays.items():
        found[name] = memory[at : at + a.nbytes].view(a.dtype).reshape(a.shape)
        found[name][...] = a
        at += -(-a.nbytes // 16) * 16
    return found


def without_sign(places: np.ndarray) -> np.ndarray:
    """An array of places or counts as compiled code reads it: unsigned, so that no index can be one from the end.

    To ask that at every access took an eighth of the step. Plain Python keeps the sign: where the compiler makes sums
    of both kinds signed, NumPy makes them floating-point numbers.

    Raises
    ------
    ValueError
        For a negative number.
    """
    if places.dtype != np.int64 or config.DISABLE_JIT:  # pyright: ignore[reportAttributeAccessIssue]
        return places
    if np.any(places < 0):
        raise ValueError(f"{places.min()} is no place")
    return places.view(np.uint64)


def array_view(dtype: Any, ndim: int) -> Any:
    """What compiled code calls as `view(table, place)`: the array, of this type, whose entry is there.

    `table` is the address of whole numbers, `place` counts them.
    """
    element = np.dtype(dtype)
    if config.DISABLE_JIT:  # pyright: ignore[reportAttributeAccessIssue]
        return partial(_plain_view, element, ndim)
    array = types.Array(from_dtype(element), ndim, "C")
    word = ir.IntType(64)

    @intrinsic
    def view(_context: Any, _table: Any, _place: Any) -> Any:
        def build(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
            numbers = builder.inttoptr(arguments[0], word.as_pointer())

            def number(k: int) -> Any:
                return builder.load(builder.gep(numbers, [builder.add(arguments[1], word(k))]))

            found = make_array(array)(context, builder)
            shape = [number(1 + k) for k in range(ndim)]
            strides = [word(element.itemsize)]
            for length in shape[:0:-1]:
                strides.insert(0, builder.mul(strides[0], length))
            data = builder.inttoptr(number(0), found.data.type)
            populate_array(found, data, shape, strides, itemsize=word(element.itemsize), meminfo=None)
            return found._getvalue()

        return array(types.int64, types.int64), build

    return view


UNIT_ARGUMENTS = (types.int64, types.int64, types.float64, types.float64, types.float64)
"""Of a unit: operation, address of its table, time [s], step [s], step of a stage of the network [s]."""

PLAIN_UNITS: list[Callable[..., None]] = []
"""Units that are not compiled: their address is their number in this list."""


def _call_unit() -> Any:
    """What compiled code calls as `call_unit(address, *UNIT_ARGUMENTS)`.

    As Numba calls a compiled function: places for the result and for an exception come first, and what comes back is 0.
    A unit raises nothing (`assembly/object_code.py` sees to it).
    """

    @intrinsic
    def call_unit(_context: Any, _address: Any, _operation: Any, _table: Any, _t: Any, _h: Any, _gh: Any) -> Any:
        def build(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
            pointer = ir.IntType(8).as_pointer()
            given = [context.get_value_type(kind) for kind in UNIT_ARGUMENTS]
            unit = ir.FunctionType(ir.IntType(32), [pointer.as_pointer(), pointer.as_pointer(), *given])
            places = [cgutils.alloca_once(builder, pointer) for _ in range(2)]
            builder.call(builder.inttoptr(arguments[0], unit.as_pointer()), [*places, *arguments[1:]])
            return context.get_dummy_value()

        return types.void(types.int64, *UNIT_ARGUMENTS), build

    return call_unit


CLOCKS = {"linux": 1, "darwin": 6}
"""Number of the monotonic clock of the system's `clock_gettime`, where there is one."""


def _clock() -> Any:
    """What compiled code calls as `monotonic_ns()`: `time.monotonic_ns`; 0 on systems without a clock to ask."""

    @intrinsic
    def monotonic_ns(_context: Any) -> Any:
        def build(_target: Any, builder: Any, _signature: Any, _arguments: Any) -> Any:
            word, half = ir.IntType(64), ir.IntType(32)
            if sys.platform not in CLOCKS:
                return word(0)
            asked = ir.FunctionType(half, [half, word.as_pointer()])
            read = cgutils.get_or_insert_function(builder.module, asked, "clock_gettime")
            found = cgutils.alloca_once(builder, word, size=2)
            builder.call(read, [half(CLOCKS[sys.platform]), found])
            seconds, rest = builder.load(found), builder.load(builder.gep(found, [half(1)]))
            return builder.add(builder.mul(seconds, word(1_000_000_000)), rest)

        return types.int64(), build

    return monotonic_ns


def _fence() -> Any:
    """What compiled code calls as `fence()`: what was written before is seen before what is written afterwards."""

    @intrinsic
    def fence(_context: Any) -> Any:
        def build(context: Any, builder: Any, _signature: Any, _arguments: Any) -> Any:
            builder.fence("release")
            return context.get_dummy_value()

        return types.void(), build

    return fence


def _seen() -> Any:
    """What compiled code calls as `seen(numbers, k)`: a number another thread `shows`, and all it wrote before."""

    @intrinsic
    def seen(_context: Any, numbers: Any, k: Any) -> Any:
        def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            data = make_array(signature.args[0])(context, builder, arguments[0]).data
            return builder.load_atomic(builder.gep(data, [arguments[1]]), "acquire", 8)

        return types.int64(numbers, types.int64), build

    return seen


def _shows() -> Any:
    """What compiled code calls as `shows(numbers, k, value)`: write a number that another thread waits for."""

    @intrinsic
    def shows(_context: Any, numbers: Any, k: Any, value: Any) -> Any:
        def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            data = make_array(signature.args[0])(context, builder, arguments[0]).data
            builder.store_atomic(arguments[2], builder.gep(data, [arguments[1]]), "release", 8)
            return context.get_dummy_value()

        return types.void(numbers, types.int64, types.int64), build

    return shows


SPIN = {"x86_64": ("llvm.x86.sse2.pause",), "AMD64": ("llvm.x86.sse2.pause",), "aarch64": ("llvm.aarch64.hint", 1)}
"""What a waiting core does to let its twin have the execution units, by machine: the compiler's name, an argument."""


def _breathe() -> Any:
    """What compiled code calls as `breathe(rest)` while it waits: for a moment, or, if asked, for others to run."""

    @intrinsic
    def breathe(_context: Any, rest: Any) -> Any:
        def build(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
            half = ir.IntType(32)
            if sys.platform in CLOCKS:
                with builder.if_then(builder.icmp_signed("!=", arguments[0], arguments[0].type(0))):
                    asked = ir.FunctionType(half, [])
                    builder.call(cgutils.get_or_insert_function(builder.module, asked, "sched_yield"), [])
            name, *given = SPIN.get(platform.machine(), ("",))
            if name:
                asked = ir.FunctionType(ir.VoidType(), [half] * len(given))
                hint = cgutils.get_or_insert_function(builder.module, asked, name)
                builder.call(hint, [half(number) for number in given])
            return context.get_dummy_value()

        return types.void(types.int64), build

    return breathe


if config.DISABLE_JIT:  # pyright: ignore[reportAttributeAccessIssue]
    monotonic_ns: Any = time.monotonic_ns

    def call_unit(address: int, operation: int, table: int, t: float, h: float, gh: float) -> None:
        """Call one of `PLAIN_UNITS`."""
        PLAIN_UNITS[address](operation, table, t, h, gh)

    def fence() -> None:
        """Nothing: plain Python keeps the order."""

    def seen(numbers: np.ndarray, k: int) -> int:
        """A number that another thread `shows`."""
        return int(numbers.flat[k])

    def shows(numbers: np.ndarray, k: int, value: int) -> None:
        """Write a number that another thread waits for."""
        numbers.flat[k] = value

    def breathe(_rest: int) -> None:
        """Let others run."""
        time.sleep(0.0)

else:
    monotonic_ns, fence, seen, shows, breathe = _clock(), _fence(), _seen(), _shows(), _breathe()
    call_unit = _call_unit()


def _plain_view(element: np.dtype, ndim: int, table: int, place: int) -> np.ndarray:
    address, *shape = (ctypes.c_int64 * (1 + ndim)).from_address(int(table) + 8 * place)
    memory = (ctypes.c_char * int(element.itemsize * np.prod(shape))).from_address(address)
    return np.frombuffer(memoryview(memory), element).reshape(shape).view(np.recarray if element.names else np.ndarray)


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


def reads_time(function: Callable[..., Any] | None) -> bool:
    """Whether a kernel does anything with its argument `t`."""
    code = () if function is None else dis.get_instructions(getattr(function, "py_func", function))
    loads = [i.argval for i in code if i.opname.startswith("LOAD_FAST")]
    return any("t" in (names if isinstance(names, tuple) else (names,)) for names in loads)
