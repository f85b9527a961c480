"""The core of stillcal: estimators, the static detector, the engine and the diagnosis.

Nothing here reads a file, a socket or a clock. The daemon and the replay use `engine.engine.Engine`,
`calibration.record.CalibrationRecord` and `diagnosis.diagnose`.
"""
