"""The simulated phone on a pseudo-terminal, as the daemon meets one: its line and its stream of samples."""
