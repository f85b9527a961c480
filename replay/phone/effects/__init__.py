"""What a simulated sensor adds to the ideal one: one class an effect, and the registry of all."""
