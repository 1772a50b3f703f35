"""From diagram to machine: who owns which slice of the flat vectors, and the module that calls each kernel in turn."""
