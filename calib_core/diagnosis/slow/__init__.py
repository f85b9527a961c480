"""The slow diagnosis of one sensor: search among effects, joint estimate, held-out evidence, findings."""
