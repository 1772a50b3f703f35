"""The one door to the compiler.

`error_model="numpy"` makes a division by zero inf or NaN, which the step's status check reports, instead of a
branch at every division; `fastmath` stays off so that sums keep their order and two machines agree. Kernels are
never cached on disk; only the entry point of a woven module is (docs/decisions/0002-woven-module.md).
"""

from __future__ import annotations

from numba import njit

kernel = njit(error_model="numpy", fastmath=False)
entry_point = njit(error_model="numpy", fastmath=False, cache=True, nogil=True)
