"""The blind test: recordings with hidden effects, sealed keys, answers, and their scores.

No module here shares a formula with the diagnosis that it examines or imports it; only `answer` calls it.
"""
