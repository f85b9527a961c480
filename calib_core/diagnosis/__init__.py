"""A recording against its simulation: locate, name, model and judge what differs. See docs/diagnosis.md."""
