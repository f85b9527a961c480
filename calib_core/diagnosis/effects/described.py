"""What is said of effects that no class of the catalogue describes: constants, noise, values and time stamps.

A slow effect's noun, equation and next recording stand in its own class. These are found by detectors of
their own (`stillcal.calib_core.diagnosis.direct`, `motion`, `stamps`) or compared as quantities; what is
said of them stands here, and nowhere else.
"""

from __future__ import annotations

from dataclasses import dataclass

from stillcal.calib_core.diagnosis.model.records import NAME


@dataclass(frozen=True, slots=True)
class Described:
    """An effect in words. noun: within a sentence; equation: the physics; decides: what to record next."""

    noun: str
    equation: str = ""
    decides: str = ""


def _of_both(kind: str, noun: str, equation: str = "", decides: str = "") -> dict[str, Described]:
    """Return an effect of either sensor; noun: with `{}` for the sensor's name."""
    return {f"{s}_{kind}": Described(noun.format(name), equation, decides) for s, name in NAME.items()}


STILL_IN_THREE = "record one hour at rest in three attitudes: the sensor's own noise stays with its axis"

DESCRIBED = {
    **_of_both("bias", "{} bias", "raw = inv(C) true + bias, C the correction's matrix"),
    **_of_both(
        "scale",
        "{} scale and misalignment",
        "true = C (raw - bias), C = 1 + scale on its diagonal and misalignment xy, xz, yz beside it",
    ),
    **_of_both(
        "slow_noise",
        "slow noise of the {}'s bias",
        "Allan deviation of the bias at 100 s = allan_deviation_100s",
    ),
    **_of_both(
        "bias_random_walk",
        "random walk of the {}'s bias",
        "variance of bias(t + tau) - bias(t) = density^2 tau",
        "record for many hours at rest, in one place and at one temperature",
    ),
    **_of_both(
        "saturation",
        "limit of the {}'s range",
        "raw = value, but at most limit and at least -limit",
        "set a larger range, or move the phone more gently",
    ),
    **_of_both(
        "quantisation",
        "step of the {}'s values",
        "raw = step round(value / step)",
        "choose a smaller range or the raw data stream, or vibrate the phone slightly at rest",
    ),
    "noise_level": Described(
        "white noise",
        "standard deviation of a sample = density sqrt(sample rate / 2)",
        "record one hour at rest in another mode or at another rate",
    ),
    "noise_unequal_axes": Described(
        "white noise that differs between axes",
        "white noise = ratio times that of the middle axis, axis by axis",
        STILL_IN_THREE,
    ),
    "noise_heavy_tailed": Described(
        "heavy tails of the noise",
        "a part of the samples has noise ratio times larger",
        "record one hour at rest on another support: knocks show in both sensors, noise in one",
    ),
    "bandwidth": Described(
        "low-pass filter",
        "raw = low-pass of the value with -3 dB at cutoff",
        "record at the highest rate available: its noise shows the filter's shape",
    ),
    "vibration_tone": Described(
        "vibration at one frequency",
        "raw = true + amplitude sin(2 pi frequency t + phase)",
        "record once on another support, and once with fans and motors nearby switched off",
    ),
    "held_samples": Described(
        "samples that repeat the one before",
        "a fraction of the samples repeats the one before",
        "record with other applications closed",
    ),
    "missing_codes": Described("values that never occur"),
    "axis_exchange": Described("exchanged axes"),
    "sample_rate": Described("sample rate", "samples in a second = rate"),
    "clock_skew": Described(
        "error of the clock's rate",
        "stamp = (1 + relative) t",
        "record with arrival times, on a host with a synchronised clock, for some hours",
    ),
    "timestamp_jitter": Described(
        "jitter of the time stamps",
        "stamp = t + noise of standard deviation sigma",
        "record at another rate, and with the processor idle",
    ),
    "dropped_samples": Described(
        "share of samples lost",
        "each sample is lost with probability fraction",
        "record with other applications closed",
    ),
    "arrival_bursts": Described(
        "share of samples that arrive in bursts",
        "a fraction of the samples arrives late and at once",
        "record with a shorter batch length",
    ),
    "accel_gyro_time_offset": Described(
        "delay between the sensors",
        "gyroscope(t) = rate(t - delay)",
        "rotate the phone by hand, quickly, for some minutes",
    ),
    "lever_arm": Described(
        "distance of the accelerometer from the pivot",
        "raw = force + w x (w x position) + dw/dt x position, w the rate",
        "rotate the phone about another point: the estimated position should shift by the same distance",
    ),
    "unknown": Described(
        "something that no named effect explains",
        decides="repeat it with one condition changed at a time: temperature, charger, attitude, support",
    ),
}
"""By the effect's name."""
