"""A story to run: case, session, recorder, results."""
