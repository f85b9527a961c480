"""Readers of recordings, one declarative column map per format."""
