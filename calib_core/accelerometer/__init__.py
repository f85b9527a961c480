"""The accelerometer's calibration: equations, fit, result, and what the attitudes can show."""
