"""Which recording would tell more about an effect."""

from __future__ import annotations

from stillcal.calib_core.diagnosis.effects.catalogue import named_effects

NEXT = {
    "unknown": "repeat it with one condition changed at a time: temperature, charger, attitude, support",
    "saturation": "set a larger range, or move the phone more gently",
    "quantisation": "choose a smaller range or the raw data stream, or vibrate the phone slightly at rest",
    "tone": "record once on another support, and once with fans and motors nearby switched off",
    "skew": "record with arrival times, on a host with a synchronised clock, for some hours",
    "jitter": "record at another rate, and with the processor idle",
    "samples": "record with other applications closed",
    "bursts": "record with a shorter batch length",
    "offset": "rotate the phone by hand, quickly, for some minutes",
    "bandwidth": "record at the highest rate available: its noise shows the filter's shape",
    "arm": "rotate the phone about another point: the estimated position should shift by the same distance",
    "walk": "record for many hours at rest, in one place and at one temperature",
    "noise_level": "record one hour at rest in another mode or at another rate",
    "axes": "record one hour at rest in three attitudes: the sensor's own noise stays with its axis",
    "tailed": "record one hour at rest on another support: knocks show in both sensors, noise in one",
}
"""What to record next, by the end of an effect's name, where the catalogue does not say."""


def to_record(effect: str, sensor: str) -> str:
    """Return which recording would tell more about an effect; "" where nothing is known."""
    for known in named_effects():
        if (known.name, known.sensor) == (effect, sensor) and known.decides:
            return known.decides
    fitting = [k for k in NEXT if effect.endswith(k)]
    return NEXT[max(fitting, key=len)] if fitting else ""
