"""Machine code of units and of the core: made by Numba's front end and LLVM, kept as object files, loaded by LLVM.

Numba's own cache keeps a library with all its names, one for each caller, and needs Numba to read it. An object here
has one name that is seen from outside, nothing of Python in it, and is loaded in a fraction of a millisecond
(docs/decisions/0023-units.md).
"""

from __future__ import annotations

import ctypes
import re
from collections.abc import Callable, Mapping
from typing import Any, Protocol

import llvmlite.binding as llvm
from numba import types
from numba.core.ccallback import CFunc
from numba.core.compiler_lock import global_compiler_lock

from shipgrid.errors import ShipgridError
from shipgrid.model.kernel import OPTIONS, UNIT_ARGUMENTS


class HasAddress(Protocol):
    """Memory that stays as long as this does."""

    @property
    def address(self) -> int:
        """Where it is."""
        ...


Core = Callable[[int, int, int, HasAddress], int]
"""Number of steps, of those done before, worker, and what to work on: steps done, negative if the last failed."""

UNIT = types.void(*UNIT_ARGUMENTS)
CORE = types.int64(*[types.int64] * 4)
"""Of the core: steps, first step, worker, address of the table."""

MATHEMATICS = frozenset(
    f"{name}{kind}"
    for name in (
        *("sin", "cos", "tan", "sincos", "asin", "acos", "atan", "atan2", "sinh", "cosh", "tanh"),
        *("exp", "exp2", "expm1", "log", "log2", "log10", "log1p", "pow", "sqrt", "cbrt", "hypot"),
        *("floor", "ceil", "trunc", "round", "rint", "nearbyint", "fmod", "fabs", "copysign", "fmax", "fmin"),
    )
    for kind in ("", "f")
)
MEMORY = frozenset(("memcpy", "memset", "memmove"))
CLOCK = frozenset(("clock_gettime", "sched_yield"))
OUTSIDE = MATHEMATICS | MEMORY | CLOCK
"""Functions that an object may call: of the C library, and what the core asks of the system."""


class CompileError(ShipgridError):
    """A kernel that cannot be part of an object."""


def host_target() -> tuple[str, str]:
    """Name and features of the processor that objects are made for."""
    return llvm.get_host_cpu_name(), llvm.get_host_cpu_features().flatten()


def compile_object(function: Callable[..., Any], signature: Any, name: str) -> bytes:
    """Object file with one function.

    Parameters
    ----------
    function : function
        Plain, or a kernel.
    signature : numba signature
    name : str
        Under which the object has it.

    Raises
    ------
    CompileError
        If it calls what is no part of it, or may raise.
    numba.core.errors.NumbaError
        If it does not compile.
    """
    options = {key: value for key, value in OPTIONS.items() if key != "no_cfunc_wrapper"}
    plain = getattr(function, "py_func", function)
    with global_compiler_lock:
        made: Any = CFunc(plain, (signature.args, signature.return_type), {}, options)
        compiled = made._compile_uncached()
        compiled.library.finalize()
        bitcode = compiled.library._final_module.as_bitcode()
    module = llvm.parse_bitcode(bitcode)
    entry = compiled.fndesc.llvm_func_name
    for made in module.functions:
        if made.is_declaration:
            continue
        if made.name == entry:
            made.name, made.linkage = name, "external"
        else:
            made.linkage = "internal"  # Numba numbers its names anew in each process: two objects would share some
    for variable in module.global_variables:
        if not variable.is_declaration or variable.name.startswith("_ZN08NumbaEnv"):
            variable.linkage = "internal"
    cpu, features = host_target()
    target = llvm.Target.from_default_triple()
    machine = target.create_target_machine(cpu=cpu, features=features, opt=3, reloc="pic", codemodel="small")
    tuning = llvm.create_pipeline_tuning_options(speed_level=3)
    tuning.loop_vectorization = tuning.slp_vectorization = tuning.loop_interleaving = False  # sums keep their order
    passes = llvm.create_pass_builder(machine, tuning)
    passes.getModulePassManager().run(module, passes)
    _check(module, name, signature)
    return machine.emit_object(module)


def _check(module: Any, name: str, signature: Any) -> None:
    """Refuse what cannot run outside of Python. The core hands on its status, a unit has nobody to hand it to."""
    called = {made.name for made in module.functions if made.is_declaration}
    foreign = sorted(n for n in called if not n.startswith("llvm.") and n not in OUTSIDE)
    if foreign:
        raise CompileError(f"{name} calls {', '.join(foreign)}: expected mathematics only, a kernel allocates nothing")
    text = str(module.get_function(name))
    if signature == UNIT and any(value != "0" for value in re.findall(r"\n  ret i32 (\S+)", text)):
        raise CompileError(f"{name} may raise an exception: expected kernels that hand on inf or NaN instead")


_ENGINES: list[Any] = []
"""What has been loaded stays loaded: plans hold addresses of it."""


def load_objects(objects: Mapping[str, bytes]) -> dict[str, int]:
    """Addresses of functions, each of an object of its own.

    Parameters
    ----------
    objects : mapping of str to bytes
        Objects by the name of their function.
    """
    if not objects:
        return {}
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    machine = llvm.Target.from_default_triple().create_target_machine(opt=3)
    engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), machine)
    for content in objects.values():
        engine.add_object_file(llvm.object_file.ObjectFileRef.from_data(content))
    engine.finalize_object()
    _ENGINES.append(engine)
    return {name: engine.get_function_address(name) for name in objects}


def callable_core(address: int) -> Core:
    """The core as a function; it holds no interpreter lock while it runs."""
    pointer, word = ctypes.c_void_p, ctypes.c_int64
    native = ctypes.CFUNCTYPE(ctypes.c_int32, pointer, pointer, word, word, word, word)(address)

    def core(n_steps: int, first_step: int, worker: int, memory: HasAddress) -> int:
        result, exception = word(0), pointer(0)
        places = ctypes.addressof(result), ctypes.addressof(exception)
        status = native(*places, n_steps, first_step, worker, memory.address)
        assert status == 0, status
        return result.value

    return core
