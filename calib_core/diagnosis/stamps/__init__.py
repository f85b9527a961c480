"""What time stamps show directly: the clock's rate, jitter, lost samples, deliveries in bursts."""
