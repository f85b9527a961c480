"""Effects that only motion shows: time offset between the sensors and lever arm."""
