"""The diagnosis on other people's recordings: what it finds there, and what it makes of concealed effects.

`python -m stillcal.replay.real_data FOLDER` writes docs/reality.md. Nothing is tuned: every recording goes
through `stillcal diagnose`'s own path. Three questions are asked: what is found in each recording and does an
independent check support it; is a thermal curve recovered where the thermometer is withheld; are known
effects found when they are injected into real recordings, with the untouched recording as control.
"""
