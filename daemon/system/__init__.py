"""The operating system's side: systemd, signals, the log, memory."""
