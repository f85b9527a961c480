"""`make year`: a year of a phone before the daemon itself, which must not grow."""
