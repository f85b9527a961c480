"""Claims of Grammenos et al. 2018: calibration that needs no user."""
