"""The outputs of a diagnosis: summary, map, figures, page, phone file, comparison.

Nothing here judges: findings come from `stillcal.calib_core.diagnosis`, and are shown, tried and written
down.
"""
