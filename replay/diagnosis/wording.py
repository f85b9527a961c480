"""What the page and the terminal say in words: titles, equations, what to record next, verdicts."""

from __future__ import annotations

from stillcal.calib_core.diagnosis.model.records import Finding
from stillcal.calib_core.diagnosis.slow.effects import slow_entries

VERDICTS = {
    "adequate": "the simulated twin already explains this recording",
    "explained": "it differs from its twin, and what was left out explains it",
    "partly_explained": "some of what differs from its twin has a name, some has none",
    "unexplained": "it differs from its twin, and nothing in the catalogue explains it",
}

SENSORS = {"accel": "accelerometer", "gyro": "gyroscope", "timing": "stamps"}

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
    "unknown": "repeat it with one thing changed at a time: temperature, charger, attitude, support",
    "saturation": "set a larger range, or move more gently",
    "quantisation": "choose a smaller range or a raw stream; rests in motion of a few steps dither it",
    "tone": "record once on another support, and once with whatever hums switched off",
    "skew": "record with arrival times against a disciplined clock for some hours",
    "jitter": "record at another rate, and with the processor idle",
    "samples": "record with other applications closed",
    "bursts": "record with a shorter batch length",
    "offset": "turn the phone by hand, quickly, for some minutes",
    "bandwidth": "record at the highest rate there is: its noise shows the filter's shape",
    "arm": "turn it about another pivot: the sensor's place moves by as much",
    "walk": "record for many hours at rest, in one place and temperature",
    "noise_level": "record a still hour in another mode or at another rate",
    "axes": "record a still hour in three attitudes: the sensor's noise stays with its axis",
    "tailed": "record a still hour on another support: knocks show in both sensors, noise in one",
}
"""What to record next, by the end of an effect's name, where the catalogue does not say."""


def ending(effect: str, table: dict[str, str]) -> str:
    """Return the entry of the longest ending of an effect's name; "" where there is none."""
    fitting = [k for k in table if effect.endswith(k)]
    return table[max(fitting, key=len)] if fitting else ""


def to_record(finding: Finding) -> str:
    """Return the recording that would tell more."""
    if finding.sensor in ("accel", "gyro"):
        for entry in slow_entries(finding.sensor):
            if entry.effect == finding.effect and entry.decides:
                return entry.decides
    return ending(finding.effect, NEXT)


def title(finding: Finding) -> str:
    """Return a heading: name and axes."""
    where = " ".join([SENSORS.get(finding.sensor, finding.sensor), ", ".join(finding.axes)]).strip()
    return f"{finding.effect.replace('_', ' ')} ({where})"


def certainty(p: float) -> str:
    """Return how sure a p value makes one, in words."""
    for limit, words in ((1e-9, "beyond doubt"), (1e-5, "very sure"), (1e-2, "sure")):
        if p < limit:
            return words
    return "likely"


def headline(verdict: str, checked: int, of: int) -> str:
    """Return the verdict in words, with how much of what could be checked was."""
    if checked >= of:
        return VERDICTS[verdict]
    missed = f"{of - checked} of {of} checks could not be made"
    if verdict == "adequate":
        return f"nothing that could be checked speaks against its simulated twin; {missed}"
    return f"{VERDICTS[verdict]}; {missed}"


def number(value: float) -> str:
    """Return a number with four digits."""
    return f"{value:.4g}"


def judged_against(phone: str) -> str:
    """Return what is judged where a phone file is the twin."""
    return f"judged beside the phone {phone}: of what both have, parameters are the difference"


def readable(text: str) -> str:
    """Return units and what has units in it as people write them: m/s² for m/s^2."""
    return text.replace("^2", "²").replace("^3", "³")


def counted(count: int, one: str) -> str:
    """Return a number with its noun, in the plural where it is not one."""
    return f"{count} {one}" if count == 1 else f"{count} {one}s"
