"""A calibration as a whole: the pool of rests, the candidate fitted to it, its acceptance, check and record.

Others use `record.CalibrationRecord`, `rest_pool.Pool`, `candidate.fit_candidate`, `acceptance.decide`,
`drift_check.check_calibration` and `terms.correct`.
"""
