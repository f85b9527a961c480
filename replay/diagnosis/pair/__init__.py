"""Recordings of one motion: what one sensor reads less what another does, a simulation or a witness."""
