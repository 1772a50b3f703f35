"""Propeller tables and the bibliography, with their sources."""
