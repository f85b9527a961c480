"""Where samples come from: a serial line, or Linux's own industrial I/O sensors."""
