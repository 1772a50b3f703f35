"""The control: one controller, one file."""
