"""Shafts and engines."""
