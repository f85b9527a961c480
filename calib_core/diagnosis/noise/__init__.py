"""The noise of a sensor at rest: its level, spectrum and distribution, what it follows, and lines in it."""
