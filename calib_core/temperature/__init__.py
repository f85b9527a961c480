"""The bias of a sensor by temperature and time, learnt from rests.

Others use `memory.Memory`, the rests it is learnt from, `regression.learn`, which fits curve and wander,
`forecast.Forecast`, the uncertainty of a bias at another time and temperature, and what a bias may follow:
`thermometer.Thermometer` and `charger.Charger`.
"""
