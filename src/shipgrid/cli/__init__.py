"""The world outside, as a command line."""
