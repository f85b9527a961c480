"""The hourly check and zeroing: what they keep over days (Grammenos et al. 2018, 4.7)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import msgspec
import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.calibration.record import CalibrationRecord
from stillcal.calib_core.calibration.terms import correct_both
from stillcal.calib_core.engine.engine import Engine
from stillcal.calib_core.streams.events import Charging
from stillcal.calib_core.streams.samples import Samples
from stillcal.calib_core.temperature.thermometer import Thermometer
from stillcal.replay.phone import Chunk, Phone, Truth, load_phone, load_scenario, simulate
from stillcal.replay.phone.effects.on_bias import AccelBiasStep, GyroBiasDrift
from stillcal.replay.studies.claim import (
    Cause,
    Claim,
    Evidence,
    Progress,
    Study,
    Verdict,
    holds,
    picture,
    table,
)
from stillcal.replay.studies.drawing import BLUE, GREY, RED, panels, save
from stillcal.replay.studies.grammenos2018.people import HOUR_S, slowed

NAME, TITLE, WORK = "quality-check", "The hourly check and zeroing, over days (4.7)", "Grammenos 2018"
PHONES, DRIFTING = ("consumer", "mpu6050"), "typical, drifting"
DAYS, RATE_HZ, LEAST_S = 3, 5.0, 10.0
"""Days lived, at a rate; s of a rest that its means are taken of."""

DRIFT = 1e-3 / 86400.0
"""rad/s^2 on every axis: a gyroscope that drifts by 1 mrad/s (0.06 deg/s) a day."""

STEP, STEP_AT = 0.1, 1.5 * 86400.0
"""m/s^2 on every axis, and when: a sensor that degrades."""

EARLIER_AT = 1.1 * 86400.0
"""The same at another time of day, to see what the time to a new calibration depends on."""

PAPER = {
    "zero": ("4.7", "zeroing the gyroscope at each hourly check alleviates a constant drift", "easily"),
    "others": ("4.7", "what zeroing gains where the bias follows other things", "-"),
    "found": ("4.7, 5.3.2", "a significant degradation is detected, and calibrated away", "stated"),
    "stable": ("4.7, 5.3.2", "deterministic errors stay the same over long periods", "stated"),
}


@dataclass(frozen=True, slots=True, eq=False)
class Days:
    """What was off at each rest, by three calibrations: none, the first one kept, and the engine's.

    t: (n,) s. rate: (n, 3) size of the mean rate, rad/s; norm: (n, 3) of the norm less gravity, m/s^2.
    stored: how often a calibration was. failed: (k,) s, when a check first failed. renewed: (m,) s, when the
    accelerometer was calibrated anew. plugged: (p,) s, when a charger was plugged in.
    """

    t: Array
    rate: Array
    norm: Array
    stored: int
    failed: Array
    renewed: Array
    plugged: Array

    def later(self, since: float) -> Days:
        """Return the rests after a time, s."""
        rows = self.t >= since
        return replace(self, t=self.t[rows], rate=self.rate[rows], norm=self.norm[rows])


def live(phone: Phone, duration: float, seed: int) -> Days:
    """Let the engine live through the beginning of `week` and look at every rest before it does."""
    scenario = msgspec.structs.replace(load_scenario("week"), duration_s=duration)
    simulation, engine = simulate(scenario, slowed(phone, RATE_HZ), seed), Engine()
    truth, first, stored = simulation.truth, None, 0
    rows: list[list[float]] = []
    last: CalibrationRecord | None = None
    failed, renewed, plugged = [], [], []
    for chunk in simulation.chunks(seconds=60.0):
        record = engine.present.record
        if record is not None and record.gyroscope is not None and record.accelerometer is not None:
            first = first or record
            stored += record is not last
            fresh = last is None or record.accelerometer is not last.accelerometer
            renewed += [float(chunk.accelerometer.t[0])] if fresh else []
            last = record
            rows += _off(chunk, truth, (None, first, record), engine.present.thermometer)
        assert chunk.gyroscope is not None, "these phones have gyroscopes"
        before = engine.state.degraded
        engine.feed(chunk.gyroscope, chunk.accelerometer, *chunk.events)
        failed += [chunk.t_end] if engine.state.degraded and not before else []
        plugged += [e.t for e in chunk.events if isinstance(e, Charging) and e.on]
    found = np.array(rows).reshape(-1, 7)
    return Days(
        found[:, 0],
        found[:, 1:4],
        found[:, 4:],
        stored,
        np.array(failed),
        np.array(renewed),
        np.array(plugged),
    )


def _off(
    chunk: Chunk, truth: Truth, records: tuple[CalibrationRecord | None, ...], thermometer: Thermometer
) -> list[list[float]]:
    """Return t, three rates and three norms' errors of each true rest within a chunk.

    Samples are corrected as `stillcal apply` corrects them, by the records' terms too. thermometer: its
    readings before the chunk.
    """
    rows = []
    begin = float(chunk.accelerometer.t[0])
    assert chunk.gyroscope is not None
    for rest in truth.rests:
        a, b = max(rest.t_start + 0.5, begin), min(rest.t_end - 0.5, chunk.t_end)
        if b - a < LEAST_S:
            continue
        raw = chunk.accelerometer.between(a, b), chunk.gyroscope.between(a, b)
        means = [_means(*raw, record, thermometer) for record in records]
        norms = [abs(float(np.linalg.norm(force)) - rest.gravity) for force, _ in means]
        rows.append([a, *(float(np.linalg.norm(rate)) for _, rate in means), *norms])
    return rows


def _means(
    force: Samples, rate: Samples, record: CalibrationRecord | None, thermometer: Thermometer
) -> tuple[Array, Array]:
    """Return the mean force and rate, (3,) each, by a record or raw."""
    if record is not None:
        force, corrected = correct_both(record, force, rate, thermometer)
        rate = rate if corrected is None else corrected
    return np.asarray(force.xyz.mean(axis=0)), np.asarray(rate.xyz.mean(axis=0))


def recovery(days: Days, at: float) -> float:
    """Return h from a step at `at` s until ten rests by the engine err half as much as by the first one."""
    after = days.later(at)
    for k in range(9, after.t.size):
        rows = slice(k - 9, k + 1)
        if np.median(after.norm[rows, 2]) < 0.5 * np.median(after.norm[rows, 1]):
            return float(after.t[k] - at) / HOUR_S
    return np.inf


def course(days: Days, at: float) -> str:
    """Say what happened after a step at `at` s: a failed check, chargers, calibrations; h after it."""
    words = []
    for name, times in (
        ("a check failed", days.failed),
        ("a charger was plugged in", days.plugged),
        ("the accelerometer was calibrated anew", days.renewed),
    ):
        after = (times[times > at] - at) / HOUR_S
        words.append(
            f"{name} after {', '.join(f'{h:.1f}' for h in after[:3])} h" if after.size else f"never {name}"
        )
    return "; ".join(words)


def degraded(seed: int, duration: float = DAYS * 86400.0, at: float = STEP_AT) -> Days:
    """Let a typical phone live whose accelerometer's bias steps at a time."""
    phone = load_phone("typical")
    step = AccelBiasStep(step=(STEP, STEP, STEP), at_s=at)
    return live(msgspec.structs.replace(phone, effects=(*phone.effects, step)), duration, seed)


def drifting(seed: int, duration: float = DAYS * 86400.0) -> Days:
    """Let a typical phone live whose gyroscope drifts."""
    phone, drift = load_phone("typical"), GyroBiasDrift(rate=(DRIFT, DRIFT, DRIFT))
    return live(msgspec.structs.replace(phone, effects=(*phone.effects, drift)), duration, seed)


def study(data: Path | None, figures: Path, seed: int, progress: Progress) -> Study:
    """Let three phones live for days, and one that degrades."""
    lives = {DRIFTING: drifting(seed)}
    for k, name in enumerate(PHONES):
        lives[name] = live(load_phone(name), DAYS * 86400.0, seed)
        progress((k + 1) / (len(PHONES) + 2))
    broken, earlier = degraded(seed), degraded(seed, EARLIER_AT + 1.25 * 86400.0, EARLIER_AT)
    claims = (*_zero(lives), _found(broken, earlier), _stable())
    file = _draw(lives, broken, figures)
    progress(1.0)
    return Study(NAME, TITLE, claims, _text(lives, broken, file), (file,), seed)


def _zero(lives: dict[str, Days]) -> list[Claim]:
    medians = {name: 1e3 * np.median(d.later(86400.0).rate, axis=0) for name, d in lives.items()}
    ours = {name: f"{m[1]:.2f} → {m[2]:.2f} mrad/s" for name, m in medians.items()}
    raw = ", ".join(f"{name} {m[0]:.0f}" for name, m in medians.items())
    why = (
        "mean rate at rests of 10 s and more from the second day on, medians, looked at before the engine"
        f" does: by the first calibration and by the one that the check keeps up; raw: {raw} mrad/s"
    )
    data = f"{DAYS} simulated days at {RATE_HZ:.0f} Hz through the engine"
    drift = medians[DRIFTING]
    others = "; ".join(f"{name} {ours[name]}" for name in PHONES)
    return [
        Claim(
            WORK,
            *PAPER["zero"],
            ours[DRIFTING],
            f"a typical phone that drifts by {1e3 * 86400.0 * DRIFT:.0f} mrad/s a day, {data}",
            holds(bool(drift[2] <= 0.5 * drift[1])),
            f"holds where it is halved; {why}",
            evidence=Evidence.SIMULATION,
        ),
        Claim(
            WORK,
            *PAPER["others"],
            others,
            data,
            Verdict.OPEN,
            f"{why}. Not tested why; the two phones differ in more than one effect",
            evidence=Evidence.SIMULATION,
        ),
    ]


def _found(broken: Days, earlier: Days) -> Claim:
    hours = recovery(broken, STEP_AT)
    late = np.median(broken.later(STEP_AT + 24 * HOUR_S).norm, axis=0)
    ours = f"after {hours:.1f} h; norm off by {late[1]:.3f} m/s² without, {late[2]:.3f} with it"
    why = (
        f"holds where a step of {STEP:g} m/s² on all axes is halved within a day: the median of ten rests,"
        " the engine's calibration against the first one; norms a day after the step and later. What the time"
        f" goes into: {course(broken, STEP_AT)}. With the step after {EARLIER_AT / 86400.0:.1f} days it takes"
        f" {recovery(earlier, EARLIER_AT):.1f} h: {course(earlier, EARLIER_AT)}"
    )
    data = f"a typical phone, {DAYS} simulated days, the step after {STEP_AT / 86400.0:.1f}"
    return Claim(
        WORK,
        *PAPER["found"],
        ours,
        data,
        holds(hours <= 24.0),
        why,
        evidence=Evidence.SIMULATION,
        cause=Cause(f"what happened after the step: {course(broken, STEP_AT)}", shown=False),
    )


def _stable() -> Claim:
    why = "needs recordings of one phone over weeks; a simulated phone's errors stay as they are set"
    return Claim(WORK, *PAPER["stable"], "", "none", Verdict.UNTESTED, why, evidence=Evidence.NONE)


def _draw(lives: dict[str, Days], broken: Days, folder: Path) -> str:
    figure, axes = panels(2, 2)
    for axis, (name, days) in zip(axes, lives.items(), strict=False):
        for column, colour, label in ((1, RED, "first calibration kept"), (2, BLUE, "checked hourly")):
            axis.plot(
                days.t / HOUR_S, 1e3 * days.rate[:, column], ".", markersize=2, color=colour, label=label
            )
        axis.set(title=name, xlabel="time, h", ylabel="rate at rest, mrad/s", ylim=(0.0, None))
    axes[0].legend(markerscale=4)
    last = axes[len(lives)]
    for column, colour in ((1, RED), (2, BLUE)):
        last.plot(broken.t / HOUR_S, broken.norm[:, column], ".", markersize=2, color=colour)
    last.axvline(STEP_AT / HOUR_S, color=GREY, linestyle="--")
    last.set(
        title="typical, bias steps (dashed)", xlabel="time, h", ylabel="norm off, m/s²", ylim=(0.0, None)
    )
    return save(figure, folder, NAME)


def _text(lives: dict[str, Days], broken: Days, file: str) -> str:
    rows = [
        (
            name,
            str(days.t.size),
            str(days.stored),
            *(f"{1e3 * v:.3g}" for v in np.median(days.later(86400.0).rate, axis=0)),
            *(f"{v:.3g}" for v in np.median(days.later(86400.0).norm, axis=0)),
        )
        for name, days in (*lives.items(), ("typical, bias steps", broken))
    ]
    head = (
        "phone",
        "rests",
        "records",
        "rate raw, mrad/s",
        "first kept",
        "checked",
        "norm off raw, m/s²",
        "first kept",
        "checked",
    )
    return "\n\n".join(
        [
            "The engine lives through the first days of the scenario `week`. Every rest is looked at before"
            " the engine sees it: what its mean rate and its norm are off by raw, by the first calibration"
            " with both sensors, and by the one that the engine holds at that time, which it zeroes at each"
            " hourly check and replaces where a new one is better. Medians from the second day on; *records*:"
            " calibrations and zeroings held in turn.",
            table(head, rows),
            picture(
                file, "Rates at rest by the first calibration and by the one kept up; a step of the bias"
            ),
        ]
    )
