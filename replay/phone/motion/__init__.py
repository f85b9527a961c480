"""Attitudes, trajectories and gravity of the simulated phone."""
