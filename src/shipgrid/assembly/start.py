"""Outputs before the first step: every signal that follows from the states is made to agree with them."""

from __future__ import annotations

from typing import Any

import numpy as np

from shipgrid.assembly.plan import Plan, Workspace
from shipgrid.assembly.weave import type_order, type_views
from shipgrid.model.kernel import argument_names, call_uncompiled


def settle_outputs(plan: Plan, work: Workspace) -> None:
    """Evaluate the `outputs` kernels of all components once, in order, uncompiled.

    Two passes, so that what reads an output of a later stage sees it as well.

    Parameters
    ----------
    plan : Plan
    work : Workspace
        Its flat vector is changed in place.
    """
    sig = work.sig
    pairs = plan.gathers["network"]["latest"]
    for _ in range(2):
        for t in type_order(plan):
            kind = t.kind
            if kind.linear:
                continue
            gather = plan.gathers[kind.key]
            for name in ("measured", "latest"):
                sig[gather[name][:, 0]] = sig[gather[name][:, 1]]
            kernel = kind.kernels.get("outputs")
            if kernel is None:
                continue
            views = dict(type_views(plan, work, t))
            names = argument_names(kernel)
            for i in range(len(t.placed)):
                values: dict[str, Any] = {"t": 0.0, "tables": plan.step.tables, "delays": work.step.delays}
                values |= {n: views[f"{kind.key}_{n}"].view(np.recarray)[i] for n in names if n not in values}
                with np.errstate(all="ignore"):  # a machine at rest divides zero by zero where its kernel guards by inf
                    call_uncompiled(kernel, values)
        sig[pairs[:, 0]] = sig[pairs[:, 1]]
    work.step.previous[:] = sig
    work.step.watched_was[:] = sig[plan.step.watched]
