"""Questions about a model or a run: operating point, requirements, comparison."""
