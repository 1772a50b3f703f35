"""What a model is: components by declaration, records over flat vectors, one compiler, one set of frames."""

from shipgrid.model.component import Terminal, component, param, signal
from shipgrid.model.kernel import kernel

__all__ = ["Terminal", "component", "kernel", "param", "signal"]
