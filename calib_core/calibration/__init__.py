"""One phone's calibration: its record, the pool of rests, candidates, acceptance and the hourly check."""
