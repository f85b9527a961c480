"""Writing a recording in other formats than stillcal's own CSV."""
