"""The stationary detector: windows, noise floor, classification and static intervals (rests)."""
