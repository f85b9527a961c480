"""Judging given simulations: recordings of them, and phone files that are written back."""
