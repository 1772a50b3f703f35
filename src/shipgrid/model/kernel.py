"""The one door to the compiler.

`error_model="numpy"` makes a division by zero inf or NaN, which the step's status check reports, instead of a
branch at every division; `fastmath` stays off so that sums keep their order and two machines agree. Kernels are
never cached on disk; only the entry point of a woven module is (docs/decisions/0002-woven-module.md).

`_nrt=False` compiles without reference counts: a kernel that would allocate does not compile, and views of the flat vector
are passed on without the atomic increments that cost a step of the ferry several microseconds.
"""

from __future__ import annotations

from numba import njit

kernel = njit(error_model="numpy", fastmath=False, _nrt=False)
entry_point = njit(error_model="numpy", fastmath=False, _nrt=False, cache=True, nogil=True)
