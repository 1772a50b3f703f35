"""Passive electrical elements: branches, cables, filters, loads, and the meter of a bar."""
