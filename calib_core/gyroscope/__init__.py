"""The gyroscope's calibration: rotation segments between rests, gravity propagation, bias and fit."""
