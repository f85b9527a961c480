"""`make week`: a simulated week through the engine, counted."""
