"""The commands that read or make recordings; they join `stillcal` by entry point."""
