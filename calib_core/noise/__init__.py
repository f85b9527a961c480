"""Noise of a sensor at rest: Allan variance and noise covariance."""
