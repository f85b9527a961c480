"""Numerical methods that know nothing of sensors.

Damped least squares, rotations, random effects and outliers, Student's t, moving means.
"""
