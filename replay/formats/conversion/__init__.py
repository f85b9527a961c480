"""Writing a recording in other formats than stillcal's own CSV, and while it is made."""
