"""Noise of one recording as quantities that are compared: white noise and its low-pass, and slow noise."""
