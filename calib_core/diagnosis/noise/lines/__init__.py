"""Lines in the spectrum of steady stretches: whether they are there, what they are, and from when to when."""
