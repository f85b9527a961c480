"""The bias of a sensor by temperature, learnt from rests at every check, taken up or dropped on evidence.

Others use `learn.learn_gyroscope` and `learn.learn_accelerometer`, which return a `learnt.Learnt`.
"""
