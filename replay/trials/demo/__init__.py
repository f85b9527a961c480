"""`make run`: a simulated phone's day before the daemon."""
