"""What flows into the engine: runs of samples and events."""
