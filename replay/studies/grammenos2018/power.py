"""What calibrating costs: operations, processor time, sensing (Grammenos et al. 2018, 5.3, Table 9)."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np

from stillcal.calib_core.accelerometer import fit as accelerometer
from stillcal.calib_core.engine.duty_cycle import EnergySettings
from stillcal.calib_core.engine.engine import Engine
from stillcal.calib_core.engine.settings import EngineSettings, ScheduleSettings
from stillcal.calib_core.model import SensorModel
from stillcal.calib_core.streams.events import End
from stillcal.replay.phone import draw_rests, load_phone, load_scenario, simulate
from stillcal.replay.studies.claim import Claim, Evidence, Progress, Study, Verdict, holds, table
from stillcal.replay.studies.grammenos2018.kalman import Kalman, steady_gain
from stillcal.replay.studies.grammenos2018.people import slowed

NAME, TITLE, WORK = "power", "What it costs (Table 9, 5.3)", "Grammenos 2018"
POLL_HZ, APP_HZ = 50.0, 25.0
"""Table 9's rate (SENSOR_DELAY_GAME, 20 ms) and that of 5.3.2's application."""

IMU_MA = 0.925
"""Accelerometer and gyroscope in full operation: Bosch BMI160 data sheet, BST-BMI160-DS000-07, features."""

CORE_MA = 250.0
"""Assumed: one core of a phone, busy, and what wakes with it. What hangs on it says so."""

PAPER_CORE_MA = (120.0, 150.0)
"""What the paper measured while a calibration was computed (5.3.2)."""

PAPER = {
    "operations": ("5.3", "operations a reading and sensor", "9 additions, 9 multiplications"),
    "kalman": (
        "5.3.1, Table 9",
        "a Kalman filter's processor time: full matrices, as a library has it",
        "of power: 2.5 times or more",
    ),
    "fixed": (
        "5.3.1, Table 9",
        "a Kalman filter's processor time: its gain fixed once it has settled",
        "of power: 2.5 times or more",
    ),
    "current": (
        "1, 5.3.1, Table 9",
        "at least 2.5 times less power than a Kalman filter, both sensors at 50 Hz",
        "3.2 times (68.5, 220.5 mA)",
    ),
    "overhead": ("5.3.2", "overhead on an app that polls at 25 Hz", "below 5 %"),
    "fit": ("5.3.2", "a full calibration takes; ours the accelerometer's fit alone", "less than 10 s"),
    "probing": ("4.4, 5.3", "probe and window instead of continuous sensing", "the point of Algorithm 1"),
}


class Counted:
    """A number that counts what is done with it."""

    __slots__ = ("value",)
    count: ClassVar[dict[str, int]] = {}

    def __init__(self, value: float) -> None:
        self.value = value

    def _done(self, what: str, value: float) -> Counted:
        Counted.count[what] = Counted.count.get(what, 0) + 1
        return Counted(value)

    def __add__(self, other: Counted) -> Counted:
        return self._done("additions", self.value + _plain(other))

    def __sub__(self, other: Counted) -> Counted:
        return self._done("additions", self.value - _plain(other))

    def __mul__(self, other: Counted) -> Counted:
        return self._done("multiplications", self.value * _plain(other))

    def __truediv__(self, other: Counted) -> Counted:
        return self._done("divisions", self.value / _plain(other))

    __radd__, __rmul__ = __add__, __mul__


def _plain(number: Any) -> float:
    return number.value if isinstance(number, Counted) else float(number)


def _counted(values: Any) -> Any:
    return np.vectorize(Counted, otypes=[object])(np.asarray(values, dtype=float))


def operations(work: Callable[[], object]) -> dict[str, int]:
    """Return how many of each operation `work` does on Counted numbers."""
    Counted.count = {}
    work()
    return dict(Counted.count)


def counts() -> dict[str, dict[str, int]]:
    """Count one reading of one sensor: the correction, the filter's update, and that with its gain fixed."""
    model = SensorModel(_counted(np.eye(3) + 0.01), _counted([0.1, 0.2, 0.3]))
    raw = _counted([1.0, 2.0, 9.0])
    kalman = Kalman(_counted([0.0, 0.0, 9.8]), 0.01, 0.1, Counted(1.0))
    gain, estimate = Counted(0.3), kalman.x
    works: dict[str, Callable[[], object]] = {
        "apply": lambda: model.apply(raw),
        "Kalman": lambda: kalman.update(raw),
        "gain fixed": lambda: estimate + (raw - estimate) * gain,
    }
    return {name: operations(work) for name, work in works.items()}


@dataclass(frozen=True, slots=True)
class Times:
    """Processor time a reading and sensor, s, one at a time; block: the correction, in blocks of a second.

    kalman: the filter with full matrices; fixed: the same filter with the gain that it settles at.
    """

    apply: float
    kalman: float
    fixed: float
    block: float


def times(repeats: int = 2000) -> Times:
    """Measure both side by side, in turns, and return the best of each."""
    model = SensorModel.of(np.eye(3) + 0.01, [0.1, 0.2, 0.3])
    readings = np.random.default_rng(0).normal(size=(repeats, 3))
    kalman = Kalman(readings[0], 0.01, 0.1)
    best, gain, estimate = [np.inf] * 4, steady_gain(0.01, 0.1), readings[0]
    blocks = readings[: repeats // 50 * 50].reshape(-1, 50, 3)
    works: tuple[Callable[[], object], ...] = (
        lambda: [model.apply(z) for z in readings],
        lambda: [kalman.update(z) for z in readings],
        lambda: [estimate + gain * (z - estimate) for z in readings],
        lambda: [model.apply(b) for b in blocks],
    )
    for _ in range(7):
        for k, work in enumerate(works):
            begin = time.process_time()
            work()
            best[k] = min(best[k], (time.process_time() - begin) / repeats)
    return Times(*(float(b) for b in best))


@dataclass(frozen=True, slots=True)
class Day:
    """One simulated day. engine: s of processor time; sensing: share of time the sensors were asked for.

    rests: how many it found. samples: of each sensor.
    """

    engine: float
    sensing: float
    rests: int
    samples: int


def day(seed: int, watch: Literal["auto", "continuous"], progress: Progress) -> Day:
    """Let the engine live through a day of a phone polled at 25 Hz, and time it."""
    simulation = simulate(load_scenario("day"), slowed(load_phone("typical"), APP_HZ), seed)
    engine = Engine(EngineSettings(schedule=ScheduleSettings(watch=watch)))
    spent, samples = 0.0, 0
    for chunk in simulation.chunks():
        assert chunk.gyroscope is not None
        begin = time.process_time()
        engine.feed(chunk.gyroscope, chunk.accelerometer, *chunk.events)
        spent += time.process_time() - begin
        samples += len(chunk.accelerometer)
        progress(chunk.t_end / simulation.duration)
    engine.feed(End(simulation.duration))
    rests = engine.present.counters.rests
    return Day(spent, engine.ledger.asked_s / simulation.duration, rests, samples)


def fit_time(seed: int) -> float:
    """Return s of processor time of one full calibration of the accelerometer, from thirty rests."""
    rests = draw_rests(load_phone("typical"), 30, seed)
    begin = time.process_time()
    accelerometer.fit(rests.forces, rests.uncertainties, rests.gravity)
    return time.process_time() - begin


def study(data: Path | None, figures: Path, seed: int, progress: Progress) -> Study:
    """Count, measure, and put into a stated model of current."""
    done, clock = counts(), times()
    found = day(seed, "auto", lambda share: progress(0.5 * share))
    always = day(seed, "continuous", lambda share: progress(0.5 + 0.5 * share))
    claims = (
        _operations(done),
        *_kalman(done, clock),
        _current(clock),
        _overhead(found, clock),
        _fit(fit_time(seed)),
        _probing(found, always),
    )
    return Study(NAME, TITLE, claims, _text(done, clock, found, always), (), seed)


def _claim(key: str, ours: str, verdict: Verdict, data: str, because: str) -> Claim:
    simulated = key in {"overhead", "probing"}
    evidence = Evidence.SIMULATION if simulated else Evidence.ARITHMETIC
    return Claim(WORK, *PAPER[key], ours, data, verdict, because, evidence=evidence)


def _operations(done: dict[str, dict[str, int]]) -> Claim:
    ours = _words(done["apply"])
    good = done["apply"] == {"additions": 9, "multiplications": 9}
    return _claim(
        "operations",
        ours,
        holds(good),
        "counted as they are done",
        "exactly as many, subtractions as additions",
    )


def _kalman(done: dict[str, dict[str, int]], clock: Times) -> list[Claim]:
    """Set both ways to write the same filter beside the correction."""
    why = (
        "the paper measures power, not time; what power would follow is in the next row. One reading at a"
        " time, all in numpy, in one run; both ways give the same estimates once the gain has settled"
    )
    claims = []
    for key, name, spent in (("kalman", "Kalman", clock.kalman), ("fixed", "gain fixed", clock.fixed)):
        ratio, many = spent / clock.apply, sum(done[name].values()) / sum(done["apply"].values())
        ours = f"{ratio:.1f} times the time, {many:.1f} the operations"
        claims.append(_claim(key, ours, Verdict.OPEN, "measured side by side", why))
    return claims


def _current(clock: Times) -> Claim:
    """Say what a model of current gives: it decides nothing, as its answer is that of what it assumes."""
    busy = [2.0 * POLL_HZ * spent for spent in (clock.apply, clock.kalman, clock.fixed)]
    ours, kalman, fixed = (IMU_MA + CORE_MA * share for share in busy)
    ratios = {
        draw: (IMU_MA + draw * busy[1]) / (IMU_MA + draw * busy[0]) for draw in (*PAPER_CORE_MA, 2 * CORE_MA)
    }
    swept = ", ".join(f"{ratio:.1f} at {draw:.0f}" for draw, ratio in ratios.items())
    why = (
        "no battery is here, and the paper's two programs are not to be had. A model decides nothing: with"
        f" {CORE_MA:.0f} mA assumed for a busy core the filter takes {kalman / ours:.2f} times as much"
        f" ({kalman:.2f} against {ours:.2f} mA), {swept} mA (a core of the paper's phone draws"
        f" {PAPER_CORE_MA[0]:.0f} to {PAPER_CORE_MA[1]:.0f} mA, 5.3.2); on a processor ten times slower"
        f" {(IMU_MA + 10 * CORE_MA * busy[1]) / (IMU_MA + 10 * CORE_MA * busy[0]):.1f}; with its gain fixed"
        f" {fixed / ours:.2f}"
    )
    return Claim(WORK, *PAPER["current"], "", "none", Verdict.UNTESTED, why, evidence=Evidence.NONE)


def _overhead(found: Day, clock: Times) -> Claim:
    busy = (found.engine + 2.0 * found.samples * clock.block) / 86400.0
    share = busy * CORE_MA / IMU_MA
    why = (
        f"engine ({found.engine:.1f} s of processor time a day) and correction at an assumed {CORE_MA:.0f}"
        " mA, over the current of the sensors alone: an app that uses the samples takes more, and the share"
        f" would be smaller. Holds below 5 %; a core {0.05 / share:.1f} times slower than this host's would"
        " reach it"
    )
    ours = f"{share:.1%} of the sensors' own current"
    return _claim("overhead", ours, holds(share < 0.05), "a simulated day at 25 Hz, typical phone", why)


def _fit(spent: float) -> Claim:
    data = "30 rests of the typical phone, drawn"
    why = (
        "processor time on this host. The paper's includes collecting, the gyroscope and a phone of 2018;"
        " Algorithm 1 has no part in ours"
    )
    return _claim("fit", f"{1e3 * spent:.1f} ms", holds(spent < 10.0), data, why)


def _probing(found: Day, always: Day) -> Claim:
    ours = (
        f"sensors on {found.sensing / always.sensing:.1%} of the time; {found.rests} of {always.rests} rests"
    )
    why = (
        f"{found.sensing * IMU_MA:.3f} mA instead of {always.sensing * IMU_MA:.3f} mA,"
        f" {found.engine / always.engine:.2f} times the processor time; "
    )
    why += (
        f"the share follows our settings: {EnergySettings().on_time_fraction:.0%} of the time may be asked"
        " for, and the first hour is sensed without a break"
    )
    return _claim("probing", ours, Verdict.OPEN, "a simulated day at 25 Hz, typical phone", why)


def _words(done: dict[str, int]) -> str:
    return ", ".join(f"{n} {what}" for what, n in sorted(done.items()))


def _text(done: dict[str, dict[str, int]], clock: Times, found: Day, always: Day) -> str:
    rows = [
        ("correction", _words(done["apply"]), f"{1e6 * clock.apply:.2f}", f"{1e6 * clock.block:.3f}"),
        ("Kalman filter", _words(done["Kalman"]), f"{1e6 * clock.kalman:.2f}", "-"),
        ("the same, its gain fixed", _words(done["gain fixed"]), f"{1e6 * clock.fixed:.2f}", "-"),
    ]
    days = [
        (name, f"{d.sensing:.1%}", f"{d.engine:.2f}", f"{1e6 * d.engine / d.samples:.2f}",
         f"{86400 * d.sensing / d.samples * 1e3:.2f}", str(d.rests), f"{d.sensing * IMU_MA:.3f}")
        for name, d in (("probe and window", found), ("without a break", always))
    ]  # fmt: skip
    head = ("a reading of one sensor", "operations", "µs, one at a time", "µs, in blocks of a second")
    return "\n\n".join(
        [
            "Operations are counted by numbers that count. Times are processor time on the host that made"
            " this page, best of seven runs that take turns; their ratio travels, their size does not. The"
            " filter has one state a sensor and full 3x3 matrices, as a library would write it. Its gain"
            " settles within a second, and with the gain fixed it needs fewer operations than the correction:"
            " what a Kalman filter costs is a matter of how it is written.",
            table(head, rows),
            f"The model: mean current = {IMU_MA} mA for both sensors in full operation (Bosch BMI160 data"
            f" sheet, BST-BMI160-DS000-07) x share of time sensing + {CORE_MA:.0f} mA (assumed) x share of"
            f" time that a core is busy. One simulated day at {APP_HZ:.0f} Hz, {found.samples} samples of"
            " each sensor, as the engine looks at it by itself and as it does when told to look without a"
            " break; mA are the sensors' by the model:",
            table(("", "on", "engine, s", "µs a sample", "ms on a sample", "rests", "sensors, mA"), days),
        ]
    )
