"""The ship's own rules: modes, interlocks, synchronising, power management."""
