"""The engine's input: `samples.Samples`, runs of samples of one sensor, and `events.Event`."""
