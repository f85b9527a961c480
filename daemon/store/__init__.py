"""The calibration store: one JSON file that explains itself, written atomically."""
