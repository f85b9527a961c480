"""Activity recognition, which several of the studies measure calibration by."""
