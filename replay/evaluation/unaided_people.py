"""A day with nobody helping: rests found, time to a calibration, iterations (Grammenos et al. 2018, 4.2)."""

from __future__ import annotations

import os
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np

from stillcal.calib_core import accelerometer
from stillcal.calib_core.engine import Engine
from stillcal.calib_core.events import Store
from stillcal.calib_core.refusals import NotSupported
from stillcal.calib_core.samples import Array
from stillcal.replay.evaluation.claim import Claim, Progress, Study, holds, picture, table
from stillcal.replay.evaluation.drawing import BLUE, GREEN, RED, panels, save
from stillcal.replay.phone import Phone, Scenario, draw_rests, load_scenario, population, simulate

NAME, TITLE, SEED = "people", "A day with nobody helping (4.2)", "000"
PEOPLE, RATE_HZ = 100, 5.0
HOUR_S, DAY_S = 3600.0, 12 * 3600.0
STATES = 9
"""After so many the paper makes its first calibration (5.3)."""

DATA = f"{PEOPLE} simulated people of `day`, its first 12 h, phones drawn, {RATE_HZ:.0f} Hz"
PAPER = {
    "states": ("4.2", "stationary states in 12 h of a working day", "11 and 13 (two days of one person)"),
    "day": ("4.2", "first calibration within one day", "normally"),
    "enough": ("4.2", "fewer than 10 positions are needed", "usually"),
    "iterations": ("4.2", "iterations to converge", "about 10"),
}


@dataclass(frozen=True, slots=True)
class Life:
    """One person's twelve hours.

    rests, attitudes: found, and how many attitudes they are in. nine_at, calibrated_at: s until so many
    attitudes and until the first calibration, infinite where it never came. iterations: of its fit.
    sensing: share of the time that the sensors were asked for.
    """

    rests: int
    attitudes: int
    nine_at: float
    calibrated_at: float
    iterations: int
    sensing: float


def slowed(phone: Phone, rate_hz: float) -> Phone:
    """Return the phone with both sensors at another rate."""
    gyro = None if phone.gyro is None else msgspec.structs.replace(phone.gyro, rate_hz=rate_hz)
    return msgspec.structs.replace(
        phone, accel=msgspec.structs.replace(phone.accel, rate_hz=rate_hz), gyro=gyro
    )


def live(phone: Phone, scenario: Scenario, seed: int) -> Life:
    """Let the daemon's engine live through it."""
    simulation, engine = simulate(scenario, phone, seed), Engine()
    nine, calibrated, iterations = np.inf, np.inf, 0
    for chunk in simulation.chunks():
        items = () if chunk.gyroscope is None else (chunk.gyroscope,)
        for action in engine.feed(*items, chunk.accelerometer, *chunk.events):
            if isinstance(action, Store) and not np.isfinite(calibrated):
                fit = action.record.accelerometer
                calibrated, iterations = action.t, 0 if fit is None else fit.iterations or 0
        if engine.present.attitudes >= STATES:
            nine = min(nine, chunk.t_end)
    state = engine.present
    sensing = engine.ledger.asked_s / simulation.duration
    return Life(state.counters.rests, state.attitudes, nine, calibrated, iterations, sensing)


def _person(job: tuple[int, int]) -> Life:
    seed, k = job
    day = msgspec.structs.replace(load_scenario("day"), duration_s=DAY_S)
    return live(slowed(population(k + 1, seed)[k], RATE_HZ), day, seed + k)


def lives(people: int, seed: int, progress: Progress) -> list[Life]:
    """Let people live through their days, two at a time; the same seed gives the same days."""
    found = []
    with ProcessPoolExecutor(min(2, os.cpu_count() or 1)) as pool:
        for life in pool.map(_person, [(seed, k) for k in range(people)]):
            found.append(life)
            progress(0.95 * len(found) / people)
    return found


def fewest_rests(phone: Phone, seed: int, most: int = 20) -> int:
    """Return with how many rests in random attitudes the phone's accelerometer can first be calibrated."""
    rests = draw_rests(phone, most, seed)
    for n in range(3, most + 1):
        try:
            accelerometer.fit(rests.forces[:n], rests.uncertainties[:n], rests.gravity)
        except NotSupported:
            continue
        return n
    return most + 1


def study(data: Path | None, figures: Path, seed: int, progress: Progress) -> Study:
    """Let a hundred people live through twelve hours."""
    found = lives(PEOPLE, seed, progress)
    fewest = [fewest_rests(phone, seed + k) for k, phone in enumerate(population(PEOPLE, seed))]
    claims = (_states(found), _day(found), _enough(np.array(fewest)), _iterations(found))
    file = _draw(found, figures)
    progress(1.0)
    return Study(NAME, TITLE, claims, _text(found, np.array(fewest), file), (file,), seed)


def _column(found: list[Life], name: str) -> Array:
    return np.array([float(getattr(life, name)) for life in found])


def _span(values: Array) -> tuple[float, float, float]:
    low, mid, high = np.percentile(values, [5, 50, 95], method="closest_observation")
    return float(low), float(mid), float(high)


def _states(found: list[Life]) -> Claim:
    rests, attitudes = _span(_column(found, "rests")), _span(_column(found, "attitudes"))
    ours = (
        f"{rests[1]:.0f} rests (5 to 95 %: {rests[0]:.0f} to {rests[2]:.0f}) in {attitudes[1]:.0f} attitudes"
        f" ({attitudes[0]:.0f} to {attitudes[2]:.0f})"
    )
    why = (
        "would hold with 11 and 13 within 5 to 95 % of the distinct attitudes; the simulated phone is picked"
        " up and put down through the day, and the engine listens without a break for an hour at first"
    )
    good = attitudes[0] <= 11 and attitudes[2] >= 13
    return Claim(SEED, *PAPER["states"], ours, DATA, holds(good), why)


def _day(found: list[Life]) -> Claim:
    low, mid, high = _span(_column(found, "calibrated_at") / HOUR_S)
    nine = _span(_column(found, "nine_at") / HOUR_S)
    done = float(np.mean(np.isfinite(_column(found, "calibrated_at"))))
    ours = (
        f"{done:.0%} within 12 h, median {mid:.1f} h (5 to 95 %: {low:.1f} to {high:.1f}); nine attitudes"
        f" after {nine[1]:.1f} h ({nine[0]:.1f} to {nine[2]:.1f})"
    )
    why = "holds where nine in ten have one within the twelve hours; it is made when a charger is plugged in"
    return Claim(SEED, *PAPER["day"], ours, DATA, holds(done >= 0.9), why)


def _enough(fewest: Array) -> Claim:
    low, mid, high = _span(fewest)
    under = float(np.mean(fewest < 10))
    ours = f"{under:.0%} of phones; median {mid:.0f} (5 to 95 %: {low:.0f} to {high:.0f})"
    why = "usually: in more than half; random attitudes, one after another, until the fit is not refused"
    data = f"{PEOPLE} phones drawn as in Stisen et al., rests drawn"
    return Claim(SEED, *PAPER["enough"], ours, data, holds(under > 0.5), why)


def _iterations(found: list[Life]) -> Claim:
    steps = np.array([life.iterations for life in found if np.isfinite(life.calibrated_at)], dtype=float)
    low, mid, high = _span(steps)
    why = "within a half of ten, as rough as the word; Eq. 8 at 1e-6 with Marquardt's damping of Eq. 6"
    ours = f"{mid:.0f} (5 to 95 %: {low:.0f} to {high:.0f})"
    return Claim(SEED, *PAPER["iterations"], ours, DATA, holds(5 <= mid <= 15), why)


def _draw(found: list[Life], folder: Path) -> str:
    figure, (left, right) = panels(2)
    attitudes = _column(found, "attitudes")
    left.hist(attitudes, list(np.arange(attitudes.min() - 0.5, attitudes.max() + 1.5)), color=BLUE)
    for state in (11, 13):
        left.axvline(state, color=RED, linestyle="--")
    left.set(xlabel="distinct attitudes in 12 h (dashed: the paper's states)", ylabel="people")
    for name, colour, label in (
        ("nine_at", GREEN, "nine attitudes"),
        ("calibrated_at", BLUE, "first calibration"),
    ):
        hours = np.sort(_column(found, name)) / HOUR_S
        hours = np.minimum(hours, DAY_S / HOUR_S)
        right.step(hours, np.arange(1, len(hours) + 1) / len(hours), where="post", color=colour, label=label)
    right.set(xlabel="hours since the start", ylabel="share of people", xlim=(0, 12))
    right.legend(loc="lower right")
    return save(figure, folder, NAME)


def _text(found: list[Life], fewest: Array, file: str) -> str:
    rows = []
    for name, words, unit in (
        ("rests", "rests", 1.0),
        ("attitudes", "distinct attitudes", 1.0),
        ("nine_at", f"{STATES} attitudes after, h", HOUR_S),
        ("calibrated_at", "first calibration after, h", HOUR_S),
        ("iterations", "iterations of its fit", 1.0),
        ("sensing", "share of time sensing", 1.0),
    ):
        rows.append((words, *(f"{v:.3g}" for v in _span(_column(found, name) / unit))))
    rows.append(
        ("rests in random attitudes until a fit is not refused", *(f"{v:.0f}" for v in _span(fewest)))
    )
    return "\n\n".join(
        [
            "Each person lives the first twelve hours of the scenario `day` with a course, attitudes and a"
            " phone of their own; both sensors run at 5 Hz to keep the study short, at which the detector has"
            " few samples a window. An infinite time means not within the twelve hours.",
            picture(file, "Attitudes found in twelve hours; time to nine attitudes and to a calibration"),
            table(("", "5 %", "median", "95 %"), rows),
        ]
    )
