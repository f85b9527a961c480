"""What effects, sensors and simulations are called in a sentence."""

from __future__ import annotations

from stillcal.calib_core.diagnosis.effects.catalogue import named_effects

NOUNS = {
    "accel_bias": "accelerometer bias",
    "gyro_bias": "gyroscope bias",
    "accel_scale": "accelerometer scale and misalignment",
    "gyro_scale": "gyroscope scale and misalignment",
    "noise_level": "white noise",
    "accel_slow_noise": "slow noise of the accelerometer's bias",
    "gyro_slow_noise": "slow noise of the gyroscope's bias",
    "sample_rate": "sample rate",
    "noise_unequal_axes": "white noise that differs between axes",
    "accel_bias_random_walk": "random walk of the accelerometer's bias",
    "gyro_bias_random_walk": "random walk of the gyroscope's bias",
    "held_samples": "samples that repeat the one before",
    "missing_codes": "values that never occur",
    "axis_exchange": "exchanged axes",
    "accel_saturation": "limit of the accelerometer's range",
    "gyro_saturation": "limit of the gyroscope's range",
    "accel_quantisation": "step of the accelerometer's values",
    "gyro_quantisation": "step of the gyroscope's values",
    "noise_heavy_tailed": "heavy tails of the noise",
    "vibration_tone": "vibration at one frequency",
    "clock_skew": "error of the clock's rate",
    "timestamp_jitter": "jitter of the time stamps",
    "dropped_samples": "share of samples lost",
    "arrival_bursts": "share of samples that arrive in bursts",
    "accel_gyro_time_offset": "delay between the sensors",
    "bandwidth": "limit of the bandwidth",
    "lever_arm": "distance of the accelerometer from the pivot",
    "unknown": "something that no named effect explains",
}
"""What differences are called within a sentence; effects of the catalogue have their own noun."""

THE_BUILT_IN = "the built-in simulation"

OF_EITHER = frozenset(
    {
        "noise_level",
        "noise_unequal_axes",
        "noise_heavy_tailed",
        "vibration_tone",
        "bandwidth",
        "held_samples",
        "missing_codes",
        "axis_exchange",
        "thermal_latent",
        "unknown",
    }
)
"""Effects of either sensor whose name does not say of which."""

BUILT_IN = "built-in"
"""The built-in simulation's name: an ideal affine sensor with plain noise, moved as the recording moved."""

SENSORS = {"accel": "accelerometer", "gyro": "gyroscope"}


def _of_column(effect: str, sensor: str) -> str:
    """Return the noun of a bias that follows a logged column, or an unknown effect's own words."""
    start, _, column = effect.partition("_bias_")
    if start == sensor and column:
        return f"change of the {SENSORS[sensor]}'s bias with {column}"
    return effect.replace("_", " ")


def noun(effect: str, sensor: str) -> str:
    """Return what an effect is called in a sentence."""
    named = {e.name: e.called() for e in named_effects()}
    name = NOUNS.get(effect) or named.get(effect) or _of_column(effect, sensor)
    return f"{name} ({SENSORS[sensor]})" if effect in OF_EITHER and sensor in SENSORS else name


def simulation_text(name: str) -> str:
    """Return what a simulation is called in a sentence."""
    return THE_BUILT_IN if name == BUILT_IN else name


def capital(text: str) -> str:
    """Return a text with a capital at its beginning."""
    return text[:1].upper() + text[1:]
