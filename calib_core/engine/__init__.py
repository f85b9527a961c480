"""The engine decides when to measure and when to calibrate: samples and events go in, actions come out.

It runs on sample time and never waits. Others use `engine.Engine`, `settings.EngineSettings`,
`state.EngineState` and the records of `actions`.
"""
