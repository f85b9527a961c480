"""The engine: samples and events go in, actions come out; it runs on sample time and never waits."""
