"""Detection of rests: the static detector of Grammenos et al. 2018 (4.4 and Algorithm 1), made streaming.

Others use `detector.StationaryDetector`, `rest.RestState` and the records of `settings`.
"""
