"""Time: how a step of the network is solved, and what is kept of it."""
