"""Claims of the ESGI'95 report: laboratory calibration of a phone's accelerometer."""
