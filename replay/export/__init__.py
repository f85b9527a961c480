"""Calibrations in other tools' own files: one target, one module, with the source of its convention.

`targets.TARGETS` lists them. `imu.ImuParameters` is what all of them write and read.
"""
