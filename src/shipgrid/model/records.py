"""Declared fields <-> record type <-> slice of a flat vector.

A record is a named view of the flat vector the solver steps: `x.psi_d` in a kernel is one element of it. The same
view works compiled and uncompiled (`NUMBA_DISABLE_JIT=1`), for real numbers and, for exact derivatives, for complex.
"""

from __future__ import annotations

import inspect
import typing
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np

from shipgrid.model.component import Empty, fields_of, parameters_of, type_of, unit_of

COMPLEX_STEP = 1e-40
"""Step of a number along the imaginary axis for an exact derivative: far below its rounding, far above underflow."""


@cache
def record_dtype(record: type, scalar: str = "f8") -> np.dtype:
    """Structured dtype of a record class (nested blocks nest), all fields of type `scalar` (`"f8"` or `"c16"`)."""
    hints = typing.get_type_hints(record, vars(inspect.getmodule(record)), include_extras=True)
    fields = [
        (name, scalar if unit_of(hint) is not None else record_dtype(hint, scalar)) for name, hint in hints.items()
    ]
    return np.dtype((np.record, fields))


@cache
def parameter_dtype(cls: type, scalar: str = "f8") -> np.dtype:
    """Structured dtype of a component's parameters and derived constants."""
    names = [name for name, *_ in parameters_of(cls)] + [f.name for f in fields_of(type_of(cls).derived)]
    return np.dtype((np.record, [(name, scalar) for name in names]))


def size_of(record: type) -> int:
    """Number of scalars in a record class."""
    return 0 if record is Empty else len(fields_of(record))


def names_of(record: type) -> list[str]:
    """Flat field names of a record class, in the order of the flat vector."""
    return [] if record is Empty else [f.name for f in fields_of(record)]


def initial_of(record: type) -> np.ndarray:
    """Declared initial values of a record class, flat."""
    return np.array([f.signal.initial for f in fields_of(record)], dtype=float)


def make_record(record: type, values: Mapping[str, Any] | None = None, scalar: str = "f8") -> Any:
    """One record by itself, as a test or an analysis wants it, with `values` set on top of the initial ones.

    Examples
    --------
    >>> x = make_record(State, {"i_l": 100.0}); x.i_l
    100.0
    """
    if record is Empty:
        return None
    flat = np.zeros(size_of(record), dtype=scalar)
    flat[:] = initial_of(record)
    for name, value in (values or {}).items():
        flat[names_of(record).index(name)] = value
    return flat.view(record_dtype(record, scalar)).view(np.recarray)[0]


def flat_of(record: Any) -> np.ndarray:
    """The numbers of one record (from `make_record`), flat: the same memory, so that writing changes the record."""
    return np.asarray(record).reshape(1).view("c16" if _scalar_is_complex(record.dtype) else "f8")


def _scalar_is_complex(dtype: np.dtype) -> bool:
    while dtype.names:
        dtype = dtype[0]
    return dtype.kind == "c"


def parameter_values(item: Any, tables: list[np.ndarray]) -> np.ndarray:
    """Flat parameter record of a component instance; arrays among its derived constants are appended to `tables`.

    A derived array is replaced by its offset in the pool that `tables` will be concatenated to; its length, where a
    kernel needs it, is a derived constant of its own.
    """
    kind = type_of(item)
    values = [float(getattr(item, name)) for name, *_ in parameters_of(type(item))]
    if kind.derive is not None:
        derived = dict(kind.derive(item))
        for name in names_of(kind.derived):
            value = derived.pop(name, 0.0) if name == "line" else derived.pop(name)
            if isinstance(value, np.ndarray):
                offset = sum(len(t) for t in tables)
                tables.append(np.ascontiguousarray(value, dtype=float).ravel())
                value = float(offset)
            values.append(float(value))
        if derived:
            raise TypeError(f"{kind.name}: derive returns undeclared {sorted(derived)}")
    return np.array(values)


def parameter_record(item: Any, scalar: str = "f8") -> tuple[Any, np.ndarray]:
    """Parameter record `p` of one component instance and its pool `tables`, for a test or an analysis."""
    tables: list[np.ndarray] = []
    flat = parameter_values(item, tables).astype(scalar)
    if not len(flat):
        return None, np.zeros(0)
    p = flat.view(parameter_dtype(type(item), scalar)).view(np.recarray)[0]
    return p, np.concatenate(tables) if tables else np.zeros(0)


class PlainRecord:
    """Named numbers on plain Python objects, blocks nested: an uncompiled kernel is much faster on it than on a record.

    Parameters
    ----------
    names : sequence of str
        Flat names of the fields, in the order of the flat vector.
    initial : scalar
        What each field holds at first.

    Attributes
    ----------
    top : SimpleNamespace
        What a kernel is handed.
    """

    def __init__(self, names: Sequence[str], initial: Any = 0.0):
        self.top = SimpleNamespace()
        self.names = list(names)
        self.flat = not any("." in name for name in names)
        self.slots: list[tuple[dict[str, Any], str]] = []
        for name in names:
            *blocks, last = name.split(".")
            owner = self.top
            for block in blocks:
                if not hasattr(owner, block):
                    setattr(owner, block, SimpleNamespace())
                owner = getattr(owner, block)
            self.slots.append((vars(owner), last))
        self.write([initial] * len(self.names))

    def write(self, values: Iterable[Any]) -> None:
        """Let the fields hold these.

        Parameters
        ----------
        values : iterable of scalar
            As many as there are fields.
        """
        if self.flat:
            vars(self.top).update(zip(self.names, values, strict=True))
            return
        for (owner, name), value in zip(self.slots, values, strict=True):
            owner[name] = value

    def read(self) -> list[Any]:
        """What the fields hold."""
        return [owner[name] for owner, name in self.slots]
