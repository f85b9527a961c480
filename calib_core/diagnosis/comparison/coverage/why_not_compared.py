"""Why a quantity of two recordings is not compared: the reason that really decided."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stillcal.calib_core.diagnosis.comparison import sample_rate
from stillcal.calib_core.diagnosis.comparison.coverage.looked_for import (
    direct_checks,
    obstacle,
    uninformed,
    why_not_logged,
)
from stillcal.calib_core.diagnosis.comparison.linear.wanted import Wanted
from stillcal.calib_core.diagnosis.comparison.noise import slow_noise, white_noise
from stillcal.calib_core.diagnosis.comparison.quantity import Key, Quantity
from stillcal.calib_core.diagnosis.examination import Examination
from stillcal.calib_core.diagnosis.inference.noise_models import AVERAGED


def why_not_compared(
    key: Key,
    pair: tuple[Quantity | None, Quantity | None],
    exams: tuple[Examination, Examination],
    names: tuple[str, str],
    wanted: Sequence[Wanted],
) -> str | None:
    """Say why a quantity cannot be compared; None where it can."""
    for quantity, other, exam, name in zip(pair, reversed(pair), exams, names, strict=True):
        if quantity is None:
            return f"{name}: {_why_absent(key, exam, wanted, other)}"
        if not quantity.logarithmic and not quantity.informed.any():
            return f"{name}: {uninformed(key[0])}"
    one, other = pair
    assert one is not None and other is not None, "a missing one was told of above"
    if key[0] == "sample_rate" and np.abs(one.value - other.value).max() < sample_rate.ALIKE_RATE:
        even = [n for e, n in zip(exams, names, strict=True) if sample_rate.exactly_even(e.accelerometer.t)]
        if names[0] in even:
            return (
                f"{names[0]}: its stamps are exactly even, so they were computed and say nothing of its clock"
            )
    if not one.logarithmic and not (one.informed & other.informed).any():
        return "the two show it on different axes"
    return None


def _why_absent(key: Key, exam: Examination, wanted: Sequence[Wanted], other: Quantity | None) -> str:
    """Say why a recording has no such quantity: the first reason that applies. other: the other's."""
    effect, sensor = key
    drivers = [w.hypothesis.effect for w in wanted]
    unlogged = [why_not_logged(exam, e) for e in drivers if e.key == key]
    streams = [s for s in exam.streams if s.sensor == sensor]
    if effect in (white_noise.LEVEL, white_noise.LOW_PASS):
        return white_noise.why_not_measured(effect, streams[0], other) if streams else "no such sensor"
    if effect == "held_samples" and streams and (streams[0].silent or streams[0].hidden):
        return white_noise.why_no_density(streams[0])
    if sensor == "timing":
        unlooked = next((c.reason for c in direct_checks(exam) if (c.effect, c.sensor) == key), None)
        return unlooked or exam.why_no_delay or uninformed(effect)
    first = obstacle(exam, effect, sensor)
    if first is None and effect.endswith("slow_noise"):
        whys = (slow_noise.why_no_slow_noise(exam, r) for r in exam.sensors if r.sensor == sensor)
        return next((why for why in whys if why), f"too few rests of {AVERAGED:.0f} s")
    return first or next((why for why in unlogged if why), None) or uninformed(effect)
