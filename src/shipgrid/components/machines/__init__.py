"""Electric motors."""
