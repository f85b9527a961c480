"""Default settings, phones, scenarios, formats and service units; data only."""
