"""Rests: the seconds in which the phone lies still, and the bins that they are cut into."""
