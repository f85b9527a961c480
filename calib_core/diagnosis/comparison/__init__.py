"""A recording against a given simulation: the same physical quantities are measured in both and subtracted.

`compare` takes two examinations (`stillcal.calib_core.diagnosis.diagnose.examine`) and returns what differs,
what agrees, what cannot be compared and why, and how small a difference would have been seen.
"""
