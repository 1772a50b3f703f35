"""Reference ships and their scenarios."""
