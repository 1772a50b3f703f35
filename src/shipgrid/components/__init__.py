"""The physics: one device, one file."""
