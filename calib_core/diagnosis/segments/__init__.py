"""Cutting a recording into windows, static bins and orientations, with a temperature for each."""
