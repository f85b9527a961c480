"""Trials of the whole product: faults, a week, a demonstration, and the generated pages."""
