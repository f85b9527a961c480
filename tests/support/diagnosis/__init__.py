"""Simulated nulls and effects for tests of the diagnosis; they share no code with it."""
