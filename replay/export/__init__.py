"""Calibrations in other tools' own files: one target, one module, with the source of its convention.

`targets` has them by name. `imu.ImuParameters` is what all of them write and read.
"""
