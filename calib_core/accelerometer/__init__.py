"""The accelerometer's calibration from rests: equations, fit, observability of its parameters, fleet prior.

Others use `fit.fit`, `result.AccelerometerFit`, `known_attitudes.calibrate_faces` and `prior.fit`.
"""
