"""Readers of binary logs, one file each: what sensors a log holds, and their samples as tables."""
