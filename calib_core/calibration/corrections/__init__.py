"""Effects beyond the affine model that a calibration can correct: one effect, one class, one file.

catalogue.py lists them. terms.py, one level up, applies them.
"""
