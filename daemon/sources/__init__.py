"""Sources of samples: a phone on a serial line, or the machine's own sensors (Linux industrial I/O)."""
