"""Detection, naming and interval coverage against d', on bins with white noise or a random walk.

    python tests/core/misfit/power.py --trials 20 --d 6,8 [--family white]

d' is that of the effect after the baseline is projected out, under the covariance the noise was drawn from.
"""

from __future__ import annotations

import argparse

import nulls
import numpy as np

from stillcal.calib_core.misfit.catalogue import slow_entries
from stillcal.calib_core.misfit.scenes import scenes
from stillcal.calib_core.misfit.search import forward, proposals
from stillcal.calib_core.misfit.slow import findings_of
from stillcal.calib_core.misfit.views import View
from stillcal.calib_core.noise import random_walk_covariance

Array = np.ndarray
WALK = 0.05


def curve_of(name: str, day: nulls.Day) -> Array:
    """Return what an effect follows, per second."""
    return {
        "temperature": day.temperature - day.temperature.mean(),
        "charging": day.charging,
        "step": (day.t > 1500).astype(float),
        "warmup": 1 - np.exp(-day.t / 300.0),
        "drift": day.t / 3600.0,
        "gravity": day.up[:, 0],
    }[name]


CASES: dict[str, tuple[str, str, int, float]] = {
    "accel_bias_temperature": ("accel", "temperature", 0, 1.0),
    "gyro_bias_temperature": ("gyro", "temperature", 2, 1.0),
    "accel_charging_bias": ("accel", "charging", 1, 1.0),
    "gyro_charging_bias": ("gyro", "charging", 0, 1.0),
    "accel_bias_step": ("accel", "step", 2, 1.0),
    "gyro_bias_step": ("gyro", "step", 1, 1.0),
    "accel_warmup": ("accel", "warmup", 0, 1.0),
    "gyro_g_sensitivity": ("gyro", "gravity", 1, 1.0 / nulls.G),
}


def d_prime(view: View, signal: Array, family: str, white: float) -> float:
    """Return d' of a signal (n,) in a view, its baseline projected out."""
    covariance = np.diag(white**2 / view.duration)
    if family.startswith("walk"):
        covariance = (
            covariance + (WALK * white) ** 2 * random_walk_covariance(view.t, view.duration) * view.coupling
        )
    factor = np.linalg.cholesky(covariance)
    b, s = np.linalg.solve(factor, view.baseline[0]), np.linalg.solve(factor, signal)
    left = s - b @ np.linalg.lstsq(b, s, rcond=None)[0]
    return float(np.sqrt(left @ left))


def attempt(effect: str, d: float, family: str, seed: list[int]) -> tuple[bool, bool, bool, float] | None:
    """Return (found, named alone or in the set, interval covers, gain held out) of one trial."""
    sensor, driver, axis, unit = CASES[effect]
    rng = np.random.default_rng(seed)
    day = nulls.schedule(rng)
    while day.rest.max() < 12:
        day = nulls.schedule(rng)
    error = np.zeros((day.t.size, 3))
    error[:, axis] = curve_of(driver, day)
    state = rng.bit_generator.state
    amplitude = 1e-3 if sensor == "accel" else 1e-5
    for _ in range(2):
        rng.bit_generator.state = state
        kind = {f"{sensor}_error": amplitude * error}
        bins = nulls.bins_of(rng, day, family, **kind)
        scene = next(s for s in scenes(bins, nulls.G) if s.sensor == sensor)
        view = scene.views[0] if sensor == "accel" else scene.views[axis]
        signal = np.array(
            [
                error[int(t - w / 2) : int(t + w / 2), axis].mean()
                for t, w in zip(bins.t, bins.duration, strict=True)
            ]
        )
        along = signal * (view.project[0, :, axis] if sensor == "accel" else 1.0)
        amplitude = d / max(d_prime(view, along, family, nulls.WHITE[sensor]), 1e-30)
    if amplitude > (0.5 if sensor == "accel" else 0.02):
        return None
    steps = forward(scene, proposals(scene, slow_entries(sensor)))
    findings = findings_of(scene, steps)
    if not findings:
        return False, False, False, 0.0
    first = findings[0]
    named = first.effect == effect or any(
        a.effect == effect and a.indistinguishable for a in first.alternatives
    )
    ci = np.array(next(iter(first.parameters.values())).ci95)
    low, high = ci[axis, 0] if ci.ndim == 3 else ci[axis]
    covers = first.effect == effect and low <= amplitude * unit <= high
    return True, named, covers, first.evidence.heldout_log_score_gain


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trials", type=int, default=20)
    parser.add_argument("--d", default="6,8")
    parser.add_argument("--family", default="white")
    options = parser.parse_args()
    for effect in CASES:
        for d in (float(x) for x in options.d.split(",")):
            rows = [attempt(effect, d, options.family, [7, k]) for k in range(options.trials)]
            done = [r for r in rows if r is not None]
            found = [r for r in done if r[0]]
            named, covers = sum(r[1] for r in found), sum(r[2] for r in found)
            print(
                f"{effect:24s} d'={d:4.1f}: found {len(found)}/{len(done)}, named {named}, covers {covers}",
                flush=True,
            )


if __name__ == "__main__":
    main()
