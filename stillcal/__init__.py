"""Keeps a phone's accelerometer and gyroscope true: rests, calibration, diagnosis."""
