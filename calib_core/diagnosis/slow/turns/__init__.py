"""What gravity, carried by the gyroscope from rest to rest, shows of it."""
