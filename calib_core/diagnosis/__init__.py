"""A recording against its simulated twin: locate, name, model and judge what differs. See docs/diagnosis.md."""
