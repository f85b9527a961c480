"""The bias of a sensor by temperature and time, learnt from rests.

Others use `memory.Memory`, the rests it is learnt from, `breaks.learn`, which fits curve and wander (by
`regression.Regression`, with steps and doubted rests), `forecast.Forecast`, the uncertainty of a bias at
another time and temperature, and what a bias may follow: `thermometer.Thermometer` and `charger.Charger`.
"""
