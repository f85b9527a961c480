"""Recordings and the simulated phone, through the daemon's own engine."""
