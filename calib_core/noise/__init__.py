"""Coloured noise of an inertial sensor: Allan deviation, covariance models and their fits.

Others use `allan.allan_curve`, `allan.fit_allan`, `covariance.NoiseModel` and `covariance.fit_noise`.
"""
