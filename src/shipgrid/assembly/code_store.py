"""Where units and the core are kept once they are compiled: object files in the user's cache folder.

The name of an object carries a digest of all that it depends on, so that what is found there is right, and a device
whose file is edited is compiled anew, alone. Objects are written under another name and renamed; each carries a digest
of itself, so that a damaged one is made again.
"""

from __future__ import annotations

import contextlib
import hashlib
import importlib
import importlib.util
import os
import tempfile
from collections.abc import Callable, Iterable, Sequence
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

from numba import config
from numba.core.dispatcher import Dispatcher

from shipgrid.assembly import object_code
from shipgrid.assembly.compiling import Progress, compile_in_parallel
from shipgrid.assembly.core_text import core_text
from shipgrid.assembly.fingerprint import fingerprint, versions
from shipgrid.assembly.unit_text import unit_text
from shipgrid.model.component import ComponentType, type_of
from shipgrid.model.kernel import PLACE, PLAIN_UNITS
from shipgrid.model.ops import wrap
from shipgrid.solvers import bookkeeping, companion, conduction, crew, nodal, pacing, stub_lines

CORE = "core"
"""Name of the core among the units."""
FEW = 3
"""Objects that are compiled in this process, since to start another one takes as long."""


def cache_folder() -> Path:
    """The user's cache folder for compiled code (`SHIPGRID_CACHE` overrides it)."""
    if "SHIPGRID_CACHE" in os.environ:
        return Path(os.environ["SHIPGRID_CACHE"])
    base = os.environ.get("XDG_CACHE_HOME") or os.path.join(os.path.expanduser("~"), ".cache")
    return Path(base) / "shipgrid"


class Source:
    """Source of a unit or of the core, and the name that it has by all that it depends on.

    Parameters
    ----------
    kind : ComponentType or None
        Of a unit; of the core None.

    Attributes
    ----------
    key : str
        Of the type, or `CORE`.
    text : str
        Empty for a type of which nothing is ever asked.
    name : str
        With a digest.
    function : str
        The one that is compiled.
    """

    def __init__(self, kind: ComponentType | None):
        self.kind = kind
        self.key = CORE if kind is None else kind.key
        self.function = "core" if kind is None else "unit"
        self.text = core_text() if kind is None else unit_text(kind)
        digest = hashlib.sha256()
        cpu = object_code.host_target()
        rule = repr((companion.GAMMA, companion.KAPPA))
        for word in (versions(), *cpu, self.text, PLACE, rule, fingerprint(*self._kernels())):
            digest.update(f"{word}\0".encode())
        self.name = f"{self.key}_{digest.hexdigest()[:20]}"

    def _kernels(self) -> list[Callable[..., Any]]:
        """What the text imports."""
        if self.kind is not None:
            return [*self.kind.kernels.values(), *([wrap] if "wrap(" in self.text else [])]
        modules = bookkeeping, conduction, crew, nodal, pacing, stub_lines
        return [value for module in modules for value in vars(module).values() if isinstance(value, Dispatcher)]

    def module(self) -> ModuleType:
        """The source as a module, with a file that a debugger finds."""
        folder = cache_folder() / "source"
        path = folder / f"{self.name}.py"
        try:
            if not path.exists():
                _write(path, self.text.encode())
        except OSError:  # no cache folder to write to
            path = Path(tempfile.mkdtemp()) / path.name
            path.write_text(self.text)
        spec = importlib.util.spec_from_file_location(f"shipgrid_{self.name}", path)
        assert spec is not None and spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        return module

    def compiled(self) -> bytes:
        """Its object, compiled in this process."""
        signature = object_code.CORE if self.kind is None else object_code.UNIT
        return object_code.compile_object(getattr(self.module(), self.function), signature, self.name)

    def stored(self) -> bytes | None:
        """Its object as it is kept; None if there is none, or not as it was written."""
        try:
            content = self._path().read_bytes()
        except OSError:
            return None
        digest, found = content[:32], content[32:]
        return found if hashlib.sha256(found).digest() == digest else None

    def store(self, content: bytes) -> None:
        """Keep its object."""
        with contextlib.suppress(OSError):  # no cache folder to write to: this process has it
            _write(self._path(), hashlib.sha256(content).digest() + content)

    def _path(self) -> Path:
        return cache_folder() / "objects" / f"{self.name}.o"


def _write(path: Path, content: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.NamedTemporaryFile("wb", dir=path.parent, suffix=".tmp", delete=False) as part:
        part.write(content)
    os.replace(part.name, path)


_SOURCES: dict[str, Source] = {}
_LOADED: dict[str, int] = {}
"""Addresses of units and of the core, by the name of their object."""


def source_of(kind: ComponentType | None) -> Source:
    """Source of a type's unit, or of the core: made once, since a process runs what it has imported."""
    key = CORE if kind is None else f"{kind.cls.__module__}.{kind.cls.__qualname__}"
    known = _SOURCES.get(key)
    if known is None or known.kind is not kind:
        known = _SOURCES[key] = Source(kind)
    return known


def load(kinds: Iterable[ComponentType]) -> dict[str, int]:
    """Addresses of the units of component types, by the type's key; what is missing is compiled.

    Parameters
    ----------
    kinds : iterable of ComponentType

    Raises
    ------
    CompileError
        If a kernel cannot be part of an object.
    """
    sources = [source for source in map(source_of, kinds) if source.text]
    _load([source for source in (*sources, source_of(None)) if source.name not in _LOADED])
    return {source.key: _LOADED[source.name] for source in sources}


def _load(sources: Sequence[Source]) -> None:
    if config.DISABLE_JIT:  # pyright: ignore[reportAttributeAccessIssue]
        for source in sources:
            _LOADED[source.name] = len(PLAIN_UNITS)
            PLAIN_UNITS.append(getattr(source.module(), source.function))
    else:
        _LOADED.update(object_code.load_objects(_objects(sources)))


@cache
def core() -> object_code.Core:
    """The loop over steps, as a function."""
    load([])
    address = _LOADED[source_of(None).name]
    if config.DISABLE_JIT:  # pyright: ignore[reportAttributeAccessIssue]
        plain: Any = PLAIN_UNITS[address]
        return lambda n_steps, first_step, worker, memory: plain(n_steps, first_step, worker, memory.address)
    return object_code.callable_core(address)


def code_names(kinds: Iterable[ComponentType]) -> list[str]:
    """Names of the core and of the units of component types: the code of a run."""
    return sorted(source.name for source in map(source_of, [*kinds, None]) if source.text)


def code_digest(kinds: Iterable[ComponentType]) -> str:
    """Digest of `code_names`."""
    return hashlib.sha256(" ".join(code_names(kinds)).encode()).hexdigest()[:16]


def compile_missing(kinds: Iterable[ComponentType]) -> int:
    """Compile the core, and those units of component types, that are not kept yet; their number."""
    sources = [source for source in map(source_of, [*kinds, None]) if source.text]
    missing = [source for source in sources if source.stored() is None]
    _objects(missing)
    return len(missing)


def _objects(sources: Sequence[Source]) -> dict[str, bytes]:
    found = {source.name: source.stored() for source in sources}
    missing = [source for source in sources if found[source.name] is None]
    ours = [s for s in missing if s.kind is None or s.kind.cls.__module__.startswith("shipgrid.")]
    if len(ours) > FEW or any(source.kind is None for source in ours):
        compile_in_parallel([job_of(source.kind) for source in ours])
        found |= {source.name: source.stored() for source in ours}
    left = [source for source in missing if found[source.name] is None]
    if left:
        progress = Progress(len(left))
        for source in left:
            content = found[source.name] = source.compiled()
            source.store(content)
            progress.advance()
        progress.end()
    return {name: content for name, content in found.items() if content is not None}


def job_of(kind: ComponentType | None) -> str:
    """Name of what is to be compiled, for another process."""
    return CORE if kind is None else f"{kind.cls.__module__}:{kind.cls.__qualname__}"


def do_job(job: str) -> None:
    """Compile what another process has asked for, unless it is there."""
    kind = None
    if job != CORE:
        module, name = job.split(":")
        kind = type_of(getattr(importlib.import_module(module), name))
    source = source_of(kind)
    if source.stored() is None:
        source.store(source.compiled())
