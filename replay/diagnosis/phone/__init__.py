"""The simulated phone that a recording shows: its file, and what it records of the same motion."""
