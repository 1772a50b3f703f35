"""The clock: executor, deadlines, overruns."""
