"""A story to run: runner, recorder, results."""
