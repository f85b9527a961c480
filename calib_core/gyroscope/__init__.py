"""The gyroscope's calibration: its bias from rests, its scale from gravity propagated between rests.

Others use `fit.fit`, `bias.bias_from_rests`, `bias.update_bias` and `rotation_segment.RotationSegment`.
"""
