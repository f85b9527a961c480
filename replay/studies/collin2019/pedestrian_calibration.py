"""How much of dead reckoning's error the daemon's calibration takes away, on simulated phones.

A phone lies here and there for an hour, as on `tables`, is charged, and is then carried for ten minutes in
the pocket of a walker. The engine calibrates it from the first part only. The same life with a faultless
phone is the truth: what differs is the sensors' doing, not that of steps or their lengths.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.engine.engine import Engine
from stillcal.calib_core.gravity import STANDARD
from stillcal.calib_core.model import SensorModel
from stillcal.calib_core.streams.events import Charging
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.replay.phone import Phone, Scenario, load_phone, simulate
from stillcal.replay.phone.activities.carried import Walk
from stillcal.replay.phone.activities.resting import Rest, Table
from stillcal.replay.phone.effects.on_bias import GyroBiasTemperature
from stillcal.replay.phone.effects.on_input import GyroGSensitivity
from stillcal.replay.studies import drawing
from stillcal.replay.studies.claim import Cause, Claim, Evidence, Progress, Study, holds, picture, table
from stillcal.replay.studies.methods.navigation import dead_reckoning, headings, step_headings, up_in_body
from stillcal.replay.studies.methods.steps import PATTERNS, Steps, detect_steps, patterns, step_length

WORK = "Collin 2019"
PHONES = ("typical", "consumer", "mpu6050")
LIVES, TRIED = 4, 2
"""Lives of each phone; those of them that are lived again to find a cause."""

GOOD = 0.03
"""Relative position error, by which step lengths err at best."""

WALK_S = 600.0
STEP_M, EXPONENT = 0.75, 0.25
PATTERN = PATTERNS.index("largest difference of the norm")
UP_SPAN_S = 10.0
SUPPORTS = {
    "screen_up": 0.3,
    "screen_down": 0.15,
    "leaning": 0.15,
    "on_long_edge": 0.1,
    "upright": 0.1,
    "upside_down": 0.1,
    "bag": 0.1,
}
"""Where the phone is put down within the hour: as much variety as a day has."""


@dataclass(frozen=True, slots=True, eq=False)
class Reckoned:
    """One walk as reckoned. t: (k,) s, ends of steps; heading, pattern: (k,); position: (k + 1, 2) m."""

    t: Array
    heading: Array
    position: Array
    pattern: Array

    @property
    def distance(self) -> float:
        """Length of the way, m."""
        return float(np.linalg.norm(np.diff(self.position, axis=0), axis=1).sum())


@dataclass(frozen=True, slots=True, eq=False)
class Life:
    """One phone's life: the walk as it was, as raw sensors have it, and as calibrated ones."""

    phone: str
    true: Reckoned
    raw: Reckoned
    calibrated: Reckoned
    zeroed: Reckoned

    def error(self, which: Reckoned) -> float:
        """Position error at the end over the distance walked."""
        return float(np.linalg.norm(which.position[-1] - self.true.position[-1]) / self.true.distance)


def scenario() -> Scenario:
    """Return an hour on tables, a charge, and a walk."""
    return Scenario(
        segments=(
            Table(duration_s=3000.0, rest_s=(15.0, 90.0), supports=SUPPORTS),
            Rest(duration_s=900.0, charging=True),
            Walk(duration_s=WALK_S),
        )
    )


def reckon(accel: Samples, gyro: Samples, gravity: float, factor: float) -> Reckoned:
    """Reckon a walk: steps from the norm, lengths by Eq. 19, headings from the rate about up (Eq. 20-22)."""
    steps: Steps = detect_steps(accel.t, accel.xyz, gravity)
    pattern = patterns(steps, gravity)[:, PATTERN]
    forces = np.column_stack([np.interp(gyro.t, accel.t, column) for column in accel.xyz.T])
    up = up_in_body(gyro.t, gyro.xyz, forces, UP_SPAN_S)
    heading = headings(gyro.t, np.einsum("ij,ij->i", gyro.xyz, up))
    mean = step_headings(gyro.t, heading, steps.start, steps.end)
    position = dead_reckoning(step_length(pattern, factor, EXPONENT), mean)
    return Reckoned(steps.end, mean, position, pattern)


def live(name: str, seed: int, *, without: tuple[type, ...] = ()) -> Life | None:
    """Let a phone live, calibrate it on the way, and reckon its walk; None where no calibration came.

    without: effects that are taken off the phone first.
    """
    gravity = 9.8125
    phone = load_phone(name)
    kept = tuple(effect for effect in phone.effects if not isinstance(effect, without))
    accel, gyro, engine = _recorded(msgspec.structs.replace(phone, effects=kept), seed, Engine())
    true_accel, true_gyro, _ = _recorded(load_phone("ideal"), seed, None)
    pattern = patterns(detect_steps(true_accel.t, true_accel.xyz, gravity), gravity)[:, PATTERN]
    factor = STEP_M / float(np.mean(pattern**EXPONENT))
    assert engine is not None, "an engine was given"
    record = engine.state.record
    if record is None or record.accelerometer is None or record.gyroscope is None:
        return None
    right, turning = record.model(Sensor.ACCELEROMETER), record.model(Sensor.GYROSCOPE)
    zeroing = SensorModel.of(np.eye(3), turning.bias)
    return Life(
        name,
        reckon(true_accel, true_gyro, gravity, factor),
        reckon(accel, gyro, gravity, factor),
        reckon(right.correct(accel), turning.correct(gyro), gravity, factor),
        reckon(accel, zeroing.correct(gyro), gravity, factor),
    )


def _recorded(phone: Phone, seed: int, engine: Engine | None) -> tuple[Samples, Samples, Engine | None]:
    """Return the walk's samples of both sensors; the engine is fed all that comes before."""
    simulation = simulate(scenario(), phone, seed)
    begin = next(i.t_start for i in simulation.truth.intervals if i.activity == "walk") + 2.0
    accels, gyros = [], []
    for chunk in simulation.chunks(seconds=30.0):
        gyro = chunk.gyroscope
        assert gyro is not None, "phones that reckon have gyroscopes"
        if engine is not None and chunk.t_end < begin:
            engine.feed(gyro, chunk.accelerometer, *chunk.events)
        elif engine is not None:
            engine.feed(*(e for e in chunk.events if isinstance(e, Charging)))
        accels.append(chunk.accelerometer.between(begin, np.inf))
        gyros.append(gyro.between(begin, np.inf))
    joined = [Samples.joined([s for s in parts if len(s)]) for parts in (accels, gyros)]
    return joined[0], joined[1], engine


def study(data: Path | None, figures: Path, seed: int, progress: Progress) -> Study:
    """Reckon walks of several phones and lives, raw and calibrated."""
    lives: list[Life] = []
    n = len(PHONES) * LIVES
    for number in range(n):
        lived = live(PHONES[number // LIVES], seed * 1009 + number % LIVES)
        lives += [] if lived is None else [lived]
        progress(0.8 * (number + 1) / n)
    rows, claims = [], []
    for name in PHONES:
        own = [one for one in lives if one.phone == name]
        errors = np.array([[one.error(w) for w in (one.raw, one.zeroed, one.calibrated)] for one in own]).T
        rows.append((name, *map(_percents, errors), *_lengths(own)))
        cause = None if compensated(errors[0], errors[2]) else _tried(name, seed)
        claims.append(_claim(name, errors[0], errors[2], cause))
    head = (
        "phone",
        "raw, %",
        "bias of rates only, %",
        "calibrated, %",
        "length raw, %",
        "length calibrated, %",
    )
    text = (
        f"{_WORDS}\n\n{table(head, rows)}\n\nPosition error at the end of {WALK_S / 60:.0f} min over the"
        f" distance, median (least to most) of\n{len(lives)} lives in all, {n - len(lives)} others not"
        " calibrated by then; length: of the whole way, against the faultless phone's.\n\n"
        + picture(_draw(lives, figures), "One life of each phone: the way as it was, raw and calibrated")
    )
    name = "pedestrian-calibration"
    return Study(name, "Calibration and dead reckoning", tuple(claims), text, (f"{name}.png",), seed)


_WORDS = """The step lengths are K p^(1/4) of the norm's range (Eq. 17 and 19), K that of the faultless
phone, so lengths err by what the accelerometer does to that pattern. Headings are sums of the rate about up,
which the rates themselves and the mean force tell; what the raw gyroscope's bias does to a heading is most
of the error. Where rates also follow temperature or force, their bias in a pocket, after a charge, is not
what it was on a table: a bias that was right an hour ago is then wrong by that."""


def compensated(raw: Array, calibrated: Array) -> bool:
    """Return whether calibration takes out most of the position errors, shares (lives,)."""
    return bool(np.median(calibrated) < min(GOOD, 0.5 * np.median(raw)))


def _claim(name: str, raw: Array, calibrated: Array, cause: Cause | None) -> Claim:
    why = "the median is less than half of the raw one and below 3 %, by which step lengths err at best"
    return Claim(
        WORK,
        "2.2, 3.4",
        f"{name}: the bias of a consumer gyroscope is mostly taken out by calibration at rest",
        "mostly compensated",
        f"{_percents(raw)} % raw, {_percents(calibrated)} % calibrated",
        f"{raw.size} simulated lives",
        holds(compensated(raw, calibrated)),
        why,
        evidence=Evidence.SIMULATION,
        cause=cause,
    )


def _tried(name: str, seed: int) -> Cause:
    """Let the phone live again without what its rates follow, each and both; say what is left."""
    ways = (
        ("without what follows temperature", (GyroBiasTemperature,)),
        ("without what follows force", (GyroGSensitivity,)),
        ("without both", (GyroBiasTemperature, GyroGSensitivity)),
    )
    words, found = [], []
    for label, effects in ways:
        lives = [live(name, seed * 1009 + number, without=effects) for number in range(TRIED)]
        errors = [one.error(one.calibrated) for one in lives if one is not None]
        found.append(float(np.median(errors)) if errors else np.inf)
        words.append(f"{label} {_two(found[-1])} %" if errors else f"{label} none was calibrated")
    return Cause(
        f"{TRIED} of these lives, calibrated: {', '.join(words)}. Its rates follow {_followed(name)}",
        shown=min(found) < GOOD,
    )


def _followed(name: str) -> str:
    """Say what else a phone's rates follow, with its size; empty where nothing."""
    words = []
    for effect in load_phone(name).effects:
        if isinstance(effect, GyroBiasTemperature):
            words.append(f"temperature, {np.degrees(np.abs(effect.slope).max()):.2g} deg/s for each K")
        elif isinstance(effect, GyroGSensitivity):
            words.append(f"force, {np.degrees(np.abs(effect.matrix).max()) * STANDARD:.2g} deg/s for each g")
    return " and ".join(words)


def _percents(errors: Array) -> str:
    return f"{_two(np.median(errors))} ({_two(errors.min())} to {_two(errors.max())})"


def _two(share: float) -> str:
    """Return a share in percent to two digits, without an exponent."""
    return f"{100 * share:.0f}" if share >= 0.1 else f"{100 * share:.2g}"


def _lengths(lives: list[Life]) -> tuple[str, str]:
    off = [[which.distance / one.true.distance - 1.0 for which in (one.raw, one.calibrated)] for one in lives]
    raw, calibrated = np.abs(np.array(off)).mean(axis=0)
    return f"{100 * raw:.2g}", f"{100 * calibrated:.2g}"


def _draw(lives: list[Life], figures: Path) -> str:
    figure, axes = drawing.panels(len(PHONES))
    for axis, name in zip(axes, PHONES, strict=True):
        one = next(life for life in lives if life.phone == name)
        for which, colour, label in (
            (one.true, drawing.GREY, "faultless phone"),
            (one.raw, drawing.RED, "raw"),
            (one.calibrated, drawing.BLUE, "calibrated"),
        ):
            style = "--" if which is one.calibrated else "-"
            axis.plot(which.position[:, 0], which.position[:, 1], style, color=colour, label=label)
        axis.set(xlabel="x, m", ylabel="y, m", title=name, aspect="equal", adjustable="datalim")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return drawing.save(figure, figures, "pedestrian-calibration")
