"""What the slow search finds, names and covers: effects of known d' and nulls, in every noise family.

    python -m tests.support.diagnosis.power --trials 400 [--seed 1]
        [--what effects|off_catalogue|left_out|pairs|nulls]

d' is that of the effect after the baseline is projected out, under the covariance the noise was drawn from.
"""

from __future__ import annotations

import argparse
import json
import time
from collections import Counter, defaultdict
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from stillcal.calib_core.diagnosis.model.records import Finding
from stillcal.calib_core.diagnosis.model.sensor_residuals import by_sensor
from tests.support.diagnosis import effects, nulls
from tests.support.diagnosis.effects import Put
from tests.support.diagnosis.said import slow_findings

Array = np.ndarray
SIZES = (4.0, 6.0, 8.0, 12.0, 20.0)


@dataclass
class Trial:
    """One recording: what was put in, at which d', and what was said of it."""

    family: str
    put: list[Put]
    d: list[float]
    said: list[Finding]
    seconds: float
    left_out: bool = False
    marks: list[str] = field(default_factory=list)

    @property
    def names(self) -> list[str]:
        """What was found, with the sensor of the nameless."""
        return [f.effect for f in self.said]


def phone(rng: np.random.Generator, family: str) -> dict[str, nulls.Wander]:
    """Draw the wander of both sensors."""
    return {sensor: nulls.wander(rng, family, nulls.WHITE[sensor]) for sensor in nulls.WHITE}


def put_in(
    rng: np.random.Generator, day: nulls.Day, wander: dict[str, nulls.Wander], kind: str, d: float
) -> Put | None:
    """Draw an effect and scale it to d'; None where that is more than a phone may have."""
    sensor = "gyro" if kind in ("g_sensitivity", "flipped") else str(rng.choice(["accel", "gyro"]))
    if kind in ("scale_temperature", "nonlinearity"):
        sensor = "accel"
    if not effects.possible(kind, sensor, day):
        return None
    put = effects.drawn(rng, day, kind, sensor)
    plain = nulls.bins_of(np.random.default_rng(1), day, {s: nulls.Wander() for s in wander})
    residuals = next(s for s in by_sensor(plain, nulls.G) if s.sensor == sensor)
    size = d / max(effects.d_prime(residuals, nulls.cut(day)[2], put.error, wander[sensor]), 1e-30)
    if np.ptp(put.error * size, axis=0).max() > effects.LARGEST[sensor]:
        return None
    put.error, put.value = put.error * size, put.value * size
    return put


def attempt(seed: list[int], kinds: Iterable[str], count: int, left_out: bool) -> Trial | None:
    """Make one recording with `count` effects of the kinds and diagnose its bins."""
    rng = np.random.default_rng(seed)
    family = str(rng.choice(nulls.FAMILIES))
    day, wander = nulls.schedule(rng), phone(rng, family)
    chosen = [str(k) for k in rng.choice(list(kinds), count, replace=False)] if count else []
    sizes = [float(rng.choice(SIZES[2:] if count > 1 or left_out else SIZES)) for _ in chosen]
    put = [put_in(rng, day, wander, k, d) for k, d in zip(chosen, sizes, strict=True)]
    if any(p is None for p in put):
        return None
    real = [p for p in put if p is not None]
    kind = {
        f"{s}_error": sum((p.error for p in real if p.sensor == s), np.zeros((day.t.size, 3)))
        for s in nulls.WHITE
    }
    thermometer = not any(p.kind == "thermal_latent" for p in real) and bool(rng.random() < 0.7)
    thermometer |= any(p.kind in ("bias_temperature", "scale_temperature", "hysteresis") for p in real)
    charger = bool(rng.random() < 0.7) or any(p.kind in ("charging_bias", "thermal_latent") for p in real)
    bins = nulls.bins_of(rng, day, wander, **kind, thermometer=thermometer, charger=charger)
    began = time.perf_counter()
    without = {p.name for p in real if p.name} if left_out else set()
    said = [f for s in by_sensor(bins, nulls.G) for f in slow_findings(s, without)]
    trial = Trial(family, real, sizes, said, time.perf_counter() - began, left_out)
    trial.marks = [mark(p, said, left_out) for p in real]
    return trial


def mark(put: Put, said: list[Finding], left_out: bool) -> str:
    """Return "alone", "set", "unknown", "other" or "missed" for one effect put in."""
    own = [f for f in said if f.sensor == put.sensor]
    if put.name is not None and not left_out:
        if any(f.effect == put.name for f in own):
            return "alone"
        if any(a.effect == put.name and a.indistinguishable for f in own for a in f.alternatives):
            return "set"
    if any(f.effect != "unknown" for f in own):
        return "other"
    return "unknown" if own else "missed"


def false_names(trial: Trial) -> list[str]:
    """Return names given that are not true of this recording."""
    true = {p.name for p in trial.put} if not trial.left_out else set()
    return [
        f.effect
        for f in trial.said
        if f.effect not in true | {"unknown"}
        and not any(a.effect in true and a.indistinguishable for a in f.alternatives)
    ]


def covered(put: Put, said: list[Finding]) -> list[bool]:
    """Return for each component of the parameters whether its interval holds the truth."""
    found = next((f for f in said if f.effect == put.name and f.sensor == put.sensor), None)
    if found is None or put.kind == "thermal_latent":
        return []
    ci = np.concatenate(
        [np.reshape(p.ci95, (-1, 2)) for k, p in found.parameters.items() if not k.endswith("_s")]
    )
    truth = np.resize(np.append(put.value, np.zeros(6)), len(ci)) if put.value.size < len(ci) else put.value
    if put.kind == "bias_drift":
        truth = truth / 3600.0
    out = [bool(a <= x <= b) for x, (a, b) in zip(truth, ci, strict=False)]
    if "tau_s" in put.grid:
        low, high = found.parameters["tau_s"].ci95
        out.append(bool(low <= put.grid["tau_s"] <= high))
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trials", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--what", default="effects")
    parser.add_argument("--kinds", default="")
    parser.add_argument("--json", default="")
    options = parser.parse_args()
    kinds = {"off_catalogue": effects.OFF_CATALOGUE, "nulls": ()}.get(options.what, effects.CATALOGUE)
    kinds = tuple(options.kinds.split(",")) if options.kinds else kinds
    count = {"nulls": 0, "pairs": 2}.get(options.what, 1)
    made = (
        attempt([options.seed, k, count], kinds, count, options.what == "left_out")
        for k in range(options.trials)
    )
    trials = []
    for trial in made:
        if trial is not None:
            trials.append(trial)
        if trial is not None and options.json:
            with Path(options.json).open("a") as out:
                out.write(json.dumps(row(trial)) + "\n")
    table(trials)


def row(trial: Trial) -> dict[str, Any]:
    """Return one trial as a plain table."""
    put = [{"kind": p.kind, "sensor": p.sensor, "axes": np.abs(p.value).round(9).tolist()} for p in trial.put]
    said = [[f.effect, f.sensor, f.where.driver, round(f.evidence.log_bayes_factor, 1)] for f in trial.said]
    return {"family": trial.family, "put": put, "d": trial.d, "said": said, "marks": trial.marks}


def table(trials: list[Trial]) -> None:
    """Print the tables."""
    print(f"{len(trials)} recordings, {np.mean([t.seconds for t in trials]):.2f} s each")
    alarms = Counter(t.family for t in trials if not t.put and t.said)
    for family, n in Counter(t.family for t in trials if not t.put).items():
        what = Counter(f"{f.effect}/{f.where.driver}" for t in trials if t.family == family for f in t.said)
        print(f"  null {family:12s} alarms {alarms[family]} of {n} {dict(what)}")
    by_size: dict[str, Counter[str]] = defaultdict(Counter)
    by_kind: dict[str, Counter[str]] = defaultdict(Counter)
    holds: dict[str, list[bool]] = defaultdict(list)
    for t in trials:
        for p, d, m in zip(t.put, t.d, t.marks, strict=True):
            by_size[f"d'={d:4.1f}"][m] += 1
            if d >= 8.0:
                by_kind[p.kind][m] += 1
            holds[p.kind] += covered(p, t.said)
    for rows in (by_size, by_kind):
        for key in sorted(rows):
            n = sum(rows[key].values())
            shares = "  ".join(
                f"{m} {rows[key][m] / n:4.0%}" for m in ("alone", "set", "unknown", "other", "missed")
            )
            good = holds.get(key, [])
            print(
                f"  {key:20s} n={n:3d}  {shares}"
                + (f"  covers {np.mean(good):.1%} of {len(good)}" if good else "")
            )
    everything = [x for v in holds.values() for x in v]
    if everything:
        print(f"  intervals cover {np.mean(everything):.1%} of {len(everything)}")
    false = Counter(n for t in trials if t.put for n in false_names(t))
    print(
        f"  recordings with a false name {np.mean([bool(false_names(t)) for t in trials]):.1%} {dict(false)}"
    )


if __name__ == "__main__":
    main()
