"""Phones that change while they are calibrated, or after: whether stillcal says so."""
