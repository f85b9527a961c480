"""The simulated phone: motion, heat, sensors, clock."""
