"""Words of the page: equations, and what to record next."""

from __future__ import annotations

from stillcal.calib_core.diagnosis.effects.catalogue import named_effects

EQUATIONS = {
    "bias_temperature": "raw = S·true + b + <b>slope</b>·(T &minus; T₀)",
    "scale_temperature": "raw = S·(1 + <b>slope</b>·(T &minus; T₀))·true + b",
    "warmup": "raw = S·true + b + <b>amplitude</b>·(1 &minus; exp(&minus;t / <b>tau_s</b>))",
    "thermal_latent": "raw = S·true + b + <b>amplitude</b>·z(t), <b>tau_s</b>·dz/dt = heating &minus; z",
    "bias_step": "raw = S·true + b + <b>step</b> from a moment on",
    "bias_drift": "raw = S·true + b + <b>rate</b>·t",
    "charging_bias": "raw = S·true + b + <b>step</b> while charging",
    "bias_random_walk": "raw = S·true + b(t), &nbsp; var(b(t + τ) &minus; b(t)) = <b>density</b>²·τ",
    "g_sensitivity": "raw = S·rate + b + <b>matrix</b>·specific force",
    "nonlinearity": "raw = S·true + b + <b>quadratic</b>·true² + <b>cubic</b>·true³, axis by axis",
    "saturation": "raw = clip(…, &minus;<b>limit</b>, +<b>limit</b>)",
    "quantisation": "raw = <b>step</b>·round(… / <b>step</b>)",
    "noise_unequal_axes": "white noise = <b>ratio</b> &times; the middle axis's, axis by axis",
    "noise_level": "white noise = <b>ratio</b> &times; what is declared",
    "noise_heavy_tailed": "a <b>fraction</b> of the white noise is <b>ratio</b> times larger",
    "vibration_tone": "true = … + <b>amplitude</b>·sin(2π·<b>frequency</b>·t)",
    "clock_skew": "t<sub>stamp</sub> = (1 + <b>relative</b>)·t",
    "timestamp_jitter": "t<sub>stamp</sub> = t + noise of standard deviation <b>sigma</b>",
    "dropped_samples": "each sample is lost with chance <b>fraction</b>",
    "arrival_bursts": "a <b>fraction</b> of the samples arrives late and at once",
    "time_offset": "rate<sub>raw</sub>(t) = rate(t &minus; <b>delay</b>)",
    "bandwidth": "raw = low-pass at <b>cutoff</b> of (…)",
    "lever_arm": "raw = force + ω &times; (ω &times; <b>position</b>) + dω/dt &times; <b>position</b>",
}
"""Forward equations by the end of an effect's name; parameters in bold. Trusted HTML."""

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


def ending(effect: str, table: dict[str, str]) -> str:
    """Return the entry of the longest ending of an effect's name; "" where there is none."""
    fitting = [k for k in table if effect.endswith(k)]
    return table[max(fitting, key=len)] if fitting else ""


def to_record(effect: str, sensor: str) -> str:
    """Return which recording would tell more about an effect; "" where nothing is known."""
    for known in named_effects():
        if (known.name, known.sensor) == (effect, sensor) and known.decides:
            return known.decides
    return ending(effect, NEXT)


def readable(text: str) -> str:
    """Return a text with its units as people write them: m/s² for m/s^2."""
    return text.replace("^2", "²").replace("^3", "³")
