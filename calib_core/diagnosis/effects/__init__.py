"""The catalogue of slow effects: one effect, one class, with its physics, priors and words in one place."""
