"""Numerical tools that know nothing of sensors."""
