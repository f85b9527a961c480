"""Item 7: the error at a random moment of simulated weeks, hot or cold, and whether stated intervals hold.

`python benchmarks/truth.py --phones 40 --days 7 --jobs 2` prints the tables; `--phones 1 --days 3` takes
about a minute. Every ten minutes after the first calibration, what each contender would tell is compared with
the truth. `--no-thermometer` withholds the temperatures; the rivals need them, and do not take part.
`--keep DIR` keeps each life that has ended, and a run that was stopped goes on from there: forty weeks take
hours. Thermometers that fail are in truth_thermometer.py.
"""

# ruff: noqa: E402 - the number of threads is read when numpy is first imported

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import astuple, dataclass, field, replace
from pathlib import Path
from typing import Any

for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import click
import numpy as np
from timing import Row
from truth_phones import MG, RATE_HZ, Life, live
from truth_rivals import DAY_S, DailyFit, OffsetTable, Vqf

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.calibration.record import CalibrationRecord
from stillcal.calib_core.calibration.terms import bias_terms
from stillcal.calib_core.engine.engine import Engine
from stillcal.calib_core.engine.settings import EngineSettings, ScheduleSettings
from stillcal.calib_core.streams.events import Temperature
from stillcal.calib_core.streams.samples import Sensor
from stillcal.replay.phone import Chunk

EVERY_S = 600.0
PHONES, DAYS, SEED = 8, 7.0, 1619
"""Of `make bench`, for the sake of its time; forty phones are `--phones 40 --days 7 --seed 1619`."""

ENGINES = {
    "stillcal": EngineSettings(),
    "stillcal without learning": EngineSettings(schedule=ScheduleSettings(learn_temperature=False)),
}
RIVALS = ("raw", "offset table", "vqf", "daily fit")
ACCEL, GYRO = Sensor.ACCELEROMETER, Sensor.GYROSCOPE
GOALS = {ACCEL: (0.15, 0.6, "mg"), GYRO: (0.004, 0.02, "deg/s")}
TIMES_BETTER = 5.0
"""Goal: so many times as small as the best rival's 95th percentile."""

MOMENT = np.dtype(
    [
        *((name, float) for name in ("phone", "t", "celsius", "outside_k", "age_s")),
        *(("who", "U32"), ("sensor", "U16"), ("error", float), ("apart", float, 3), ("stated", float, 3)),
    ]
)
"""One contender's sensor at one moment.

outside_k: how far the temperature lies beyond those met in the rests so far. age_s: since the bias was last
measured. error: mg, mean over all directions, common rotation out; or deg/s. apart: true bias less the one
told, and stated: its standard uncertainty, by axis, SI; NaN where none is told.
"""

_UP = np.random.default_rng(0).standard_normal((60, 3))
_FORCE = 1000 * MG * _UP / np.linalg.norm(_UP, axis=1, keepdims=True)
_ONE, _ZERO, _UNKNOWN = np.eye(3), np.zeros(3), np.full(3, np.nan)


@dataclass(frozen=True, slots=True)
class Answer:
    """A contender's answer: scale, bias by axis and its standard uncertainty, and the bias' age, s."""

    who: str
    sensor: Sensor
    bias: Array
    scale: Array = field(default_factory=lambda: _ONE)
    stated: Array = field(default_factory=lambda: _UNKNOWN)
    age_s: float = float("nan")


def read_every_minute(chunk: Chunk) -> list[Temperature]:
    """Return the thermometer's readings, once a minute, as a phone tells them with its sensors off too."""
    accel = chunk.accelerometer
    if accel.temperature is None:
        return []
    rows = np.unique(np.floor(accel.t / 60.0), return_index=True)[1]
    return [Temperature(float(accel.t[k]), float(accel.temperature[k])) for k in rows]


def without_thermometer(chunk: Chunk) -> Chunk:
    """Return a chunk whose temperatures are withheld."""
    accel, gyro = (
        None if samples is None else replace(samples, temperature=None)
        for samples in (chunk.accelerometer, chunk.gyroscope)
    )
    assert accel is not None
    return replace(chunk, accelerometer=accel, gyroscope=gyro)


@dataclass(slots=True)
class Cost:
    """What the learning engine takes: processor and on-time of the sensors, s. t: s, how far it has come."""

    t: float = 0.0
    processor_s: float = 0.0
    on_s: float = 0.0
    on_first_day_s: float = 0.0

    def add(self, t: float, processor_s: float, on_s: float) -> None:
        """Add what one chunk took, and the on-time in all."""
        self.t, self.processor_s, self.on_s = t, self.processor_s + processor_s, on_s
        if t <= DAY_S:
            self.on_first_day_s = on_s

    @property
    def processor(self) -> float:
        """Share of a core, detection and fits, for all samples that a phone sends."""
        return self.processor_s / self.t

    @property
    def on_later(self) -> float:
        """Share of the time after the first day for which the sensors are on."""
        return (self.on_s - self.on_first_day_s) / max(self.t - DAY_S, 1.0)


class Contest:
    """All contenders, living one life. met: degC, temperatures of the rests so far."""

    def __init__(self) -> None:
        self.engines = {name: Engine(settings) for name, settings in ENGINES.items()}
        self.met: list[float] = []
        self.cost = Cost()
        self._table, self._vqf, self._daily = OffsetTable(), Vqf(RATE_HZ), DailyFit()
        self._last_rest = -np.inf

    def feed(self, chunk: Chunk) -> None:
        """Give everybody the same samples; the table takes the rests that stillcal finds."""
        assert chunk.gyroscope is not None
        items = (*read_every_minute(chunk), chunk.gyroscope, chunk.accelerometer, *chunk.events)
        for name, engine in self.engines.items():
            began = time.process_time()
            engine.feed(*items)
            if name == "stillcal":
                self.cost.add(chunk.t_end, time.process_time() - began, engine.ledger.asked_s)
        if chunk.accelerometer.temperature is None:
            return
        pool = self.engines["stillcal"].present.pool
        for held in pool.since(np.nextafter(self._last_rest, np.inf)).held:
            self._table.take(held.rest)
            self._last_rest = max(self._last_rest, held.rest.t_start)
            self.met += [] if held.rest.temperature is None else [held.rest.temperature]
        self._vqf.take(chunk.gyroscope.xyz, chunk.accelerometer.xyz)
        self._daily.take(chunk.accelerometer)

    @property
    def calibrated(self) -> bool:
        """Whether every engine has a calibration of the accelerometer."""
        records = [e.present.record for e in self.engines.values()]
        return all(r is not None and r.accelerometer is not None for r in records)

    def answers(self, t: float, celsius: float | None) -> Iterator[Answer]:
        """Yield every contender's answer at t (s) and a temperature, degC, as the phone reports it."""
        for sensor in Sensor:
            yield Answer("raw", sensor, _ZERO)
            for name, engine in self.engines.items():
                record = engine.present.record
                if record is not None:
                    step = engine.present.suspected.get(sensor)
                    for answer in told_by(name, record, sensor, t, Warmth.of(engine, t, celsius)):
                        more = 0.0 if step is None else step.uncertainty
                        yield replace(answer, stated=np.hypot(answer.stated, more))
        if celsius is None:
            return
        for name, bias in (("offset table", self._table.bias(celsius)), ("vqf", self._vqf.bias())):
            if bias is not None:
                yield Answer(name, GYRO, bias)
        if (daily := self._daily.model(celsius)) is not None:
            yield Answer("daily fit", ACCEL, bias=daily[1], scale=daily[0])


@dataclass(frozen=True, slots=True)
class Warmth:
    """What an engine knows of the phone's temperature, as `bias_terms` takes it."""

    celsius: float | None
    lagged: Array | None
    charged: Array

    @classmethod
    def of(cls, engine: Engine, t: float, celsius: float | None) -> Warmth:
        """Return it at t (s) and a reading, degC, None without a thermometer."""
        past = engine.present
        if celsius is not None:
            read = float(past.thermometer.believed(np.array([t]), np.array([celsius]))[0])
            celsius = read if np.isfinite(read) else None
        lagged = None if celsius is None else past.thermometer.lagged(t, celsius)
        return cls(celsius, lagged, past.charger.at(t))


def told_by(
    name: str, record: CalibrationRecord, sensor: Sensor, t: float, warmth: Warmth
) -> Iterator[Answer]:
    """Yield what a calibration tells of a sensor at t (s); nothing without a part."""
    celsius, lagged, charged = warmth.celsius, warmth.lagged, warmth.charged
    part = record.accelerometer if sensor is ACCEL else record.gyroscope
    if part is None:
        return
    at = None if celsius is None else np.array([celsius])
    bias = part.bias + np.ravel(bias_terms(record, sensor, at, None, lagged, charged=charged))
    sd = record.bias_uncertainty_at(sensor, t, celsius, lagged, charged)
    measured = getattr(part, "zeroed_at", record.fitted_at)
    age = np.nan if measured is None else t - measured
    yield Answer(name, sensor, bias, part.scale, _UNKNOWN if sd is None else sd, age)


def force_error(scale: Array, bias: Array, forward: Array, true_bias: Array) -> float:
    """Return the mean length of the error vector over all directions, mg, the common rotation taken out."""
    told = (_FORCE @ forward.T + true_bias - bias) @ scale.T
    u, _, v = np.linalg.svd(told.T @ _FORCE)
    rotation = u @ np.diag([1, 1, np.linalg.det(u @ v)]) @ v
    return float(np.linalg.norm(told - _FORCE @ rotation.T, axis=1).mean() / MG)


def error_of(told: Answer, life: Life, true_bias: Array) -> float:
    """Return an answer's error: mg, as `force_error` has it, or deg/s."""
    if told.sensor is ACCEL:
        return force_error(told.scale, told.bias, life.forward(told.sensor), true_bias)
    return float(np.degrees(np.linalg.norm(told.scale @ (true_bias - told.bias))))


@dataclass(frozen=True, slots=True)
class Conditions:
    """How lives are lived."""

    seed: int
    days: float
    thermometer: bool = True

    @property
    def name(self) -> str:
        """Return them as a part of a file's name."""
        warmth = "" if self.thermometer else "_no_thermometer"
        return f"seed_{self.seed}_days_{self.days:g}{warmth}"


@dataclass(frozen=True, slots=True)
class Lived:
    """What one life came to. rows: its moments, of dtype MOMENT. line: a line on each engine."""

    rows: np.ndarray
    line: str
    cost: Cost


def lived(number: int, conditions: Conditions, keep: Path | None = None) -> Lived:
    """Live one life with all contenders, or read it where it is kept."""
    if keep is None:
        return _live_it(number, conditions)
    file = keep / f"phone_{number}_{conditions.name}.npz"
    if file.exists():
        with np.load(file) as kept:
            return Lived(kept["rows"], str(kept["line"]), Cost(*kept["cost"].tolist()))
    life = _live_it(number, conditions)
    half = file.with_suffix(".half")
    with half.open("wb") as out:
        np.savez_compressed(out, rows=life.rows, line=life.line, cost=np.array(astuple(life.cost)))
    half.replace(file)
    return life


def _live_it(number: int, conditions: Conditions) -> Lived:
    life, contest, rows = live(number, conditions.seed, conditions.days), Contest(), []
    thermometer = conditions.thermometer
    for chunk in life.simulation.chunks(EVERY_S):
        contest.feed(chunk if thermometer else without_thermometer(chunk))
        assert chunk.accelerometer.temperature is not None
        t, celsius, met = chunk.t_end, float(chunk.accelerometer.temperature[-1]), contest.met
        outside = max(min(met) - celsius, celsius - max(met), 0.0) if met else np.nan
        for a in contest.answers(t, celsius if thermometer else None) if contest.calibrated else ():
            truth = life.bias_at(a.sensor, t)
            error = error_of(a, life, truth)
            at = (number, t, celsius, outside, a.age_s)
            rows.append((*at, a.who, str(a.sensor), error, truth - a.bias, a.stated))
    lines = [f"phone {number} ({', '.join(life.kinds)}): {_line(n, e)}" for n, e in contest.engines.items()]
    return Lived(np.array(rows, MOMENT), "\n".join(lines), contest.cost)


def _line(name: str, engine: Engine) -> str:
    counters, ledger = engine.state.counters, engine.ledger
    terms = [] if engine.state.record is None else [t.effect for t in engine.state.record.terms]
    return f"{name}: {counters}, asked {ledger.asked_s:.0f} s; {terms}"


COLUMNS = "moments | median | 95th percentile | 95 % intervals that hold |"


def table(rows: np.ndarray) -> Iterator[str]:
    """Yield the tables in Markdown: everybody, and the engines by age and temperature."""
    yield f"| sensor | who | {COLUMNS}\n|{'---|' * 6}"
    for sensor in Sensor:
        for who in (*RIVALS, *ENGINES):
            if (own := _of(rows, sensor, who)).size:
                yield f"| {sensor} | {who} | {_figures(own, sensor)} |"
    yield f"\n| sensor | who | where | {COLUMNS}\n|{'---|' * 7}"
    for sensor in Sensor:
        for who in ENGINES:
            for where, part in _parts(_of(rows, sensor, who)):
                if part.size:
                    yield f"| {sensor} | {who} | {where} | {_figures(part, sensor)} |"


def _by_part(rows: np.ndarray) -> dict[str, dict[str, float]]:
    """Return the figures by age and temperature, as the page's tables have them."""
    return {
        where: {
            "moments": float(part.size),
            "median": float(np.median(part["error"])),
            "95th percentile": float(np.quantile(part["error"], 0.95)),
            "% of intervals that hold": 100 * _share_held(part),
        }
        for where, part in _parts(rows)
        if part.size
    }


def _of(rows: np.ndarray, sensor: Sensor, who: str) -> np.ndarray:
    return rows[(rows["sensor"] == str(sensor)) & (rows["who"] == who)]


def _figures(rows: np.ndarray, sensor: Sensor) -> str:
    median, high = np.quantile(rows["error"], (0.5, 0.95))
    unit = GOALS[sensor][2]
    return f"{rows.size} | {median:.3g} {unit} | {high:.3g} {unit} | {_holds(rows)}"


def _parts(rows: np.ndarray) -> Iterator[tuple[str, np.ndarray]]:
    age = rows["age_s"] / 3600.0
    for low, high in ((0, 1), (1, 6), (6, 24), (24, 1e9)):
        yield (
            f"{low} to {high:g} h old" if high < 1e9 else "older than a day",
            rows[(age >= low) & (age < high)],
        )
    first_day = rows["t"] <= DAY_S
    yield "in the first day", rows[first_day]
    yield "later", rows[~first_day]
    for low, high in ((-1, 0), (0, 2), (2, 1e9)):
        words = {0: "at temperatures met", 2: "up to 2 K beyond them", 1e9: "further beyond"}[high]
        yield words, rows[(rows["outside_k"] > low) & (rows["outside_k"] <= high)]


def _holds(rows: np.ndarray) -> str:
    share = _share_held(rows)
    return f"{share:.1%}" if np.isfinite(share) else "-"


def _share_held(rows: np.ndarray) -> float:
    known = np.isfinite(rows["stated"]).all(axis=1)
    if not known.any():
        return float("nan")
    return float((np.abs(rows["apart"][known]) <= 1.96 * rows["stated"][known]).mean())


def measured(numbers: range, conditions: Conditions, jobs: int, keep: Path | None = None) -> list[Lived]:
    """Live all lives, `jobs` at once; say on standard error how many have ended."""
    ended = []
    with ProcessPoolExecutor(jobs) as pool:
        how = ([value] * len(numbers) for value in (conditions, keep))
        for life in pool.map(lived, numbers, *how):
            ended.append(life)
            click.echo(f"\r{len(ended)} of {len(numbers)} lives", nl=False, err=True)
    click.echo(err=True)
    return ended


def run(quick: bool) -> Iterator[Row]:
    """Yield the rows of item 7."""
    phones, days = (1, 2.0) if quick else (PHONES, DAYS)
    lives = measured(range(phones), Conditions(SEED, days), os.cpu_count() or 1)
    yield from _costs([life.cost for life in lives])
    yield from _errors(np.concatenate([life.rows for life in lives]))


def _errors(rows: np.ndarray) -> Iterator[Row]:
    """Yield everybody's errors at all moments, and how they stand to the goals."""
    for sensor, (median_goal, high_goal, unit) in GOALS.items():
        for who in (*RIVALS, *ENGINES):
            own = _of(rows, sensor, who)
            if not own.size:
                continue
            median, high = (float(q) for q in np.quantile(own["error"], (0.5, 0.95)))
            accuracy = f"95 % intervals that hold: {_holds(own)}"
            for what, value, goal in (("median", median, median_goal), ("95th percentile", high, high_goal)):
                ours = who == "stillcal"
                parts = _by_part(own) if ours and what == "median" else {}
                row = Row("7", f"{sensor}, {who}: {what}", value, unit, accuracy=accuracy, more=parts)
                yield row.at_most(goal, value) if ours else row
        yield from _beside_best_rival(rows, sensor)


def _beside_best_rival(rows: np.ndarray, sensor: Sensor) -> Iterator[Row]:
    """Yield by how many times our 95th percentile is smaller than that of the best rival."""
    highs = {
        who: float(np.quantile(own["error"], 0.95))
        for who in (*RIVALS, "stillcal")
        if (own := _of(rows, sensor, who)).size
    }
    ours = highs.pop("stillcal", None)
    if ours is None:
        return
    best = min(highs, key=lambda who: highs[who])
    times = highs[best] / ours
    yield Row(
        "7",
        f"{sensor}: 95th percentile, times as small as the best rival's",
        times,
        "times",
        best,
        goal=f"{TIMES_BETTER:g} times",
        met=times >= TIMES_BETTER,
        margin=times / TIMES_BETTER,
    )


def _costs(costs: list[Cost]) -> Iterator[Row]:
    """Yield what the engine takes, means over the phones."""
    shares = {
        "sensors on after the first day": (np.mean([c.on_later for c in costs]), 4.0),
        "processor, engine alone": (np.mean([c.processor for c in costs]), 0.12),
    }
    for what, (share, goal) in shares.items():
        percent = 100.0 * float(share)
        yield Row("7", what, percent, "%").at_most(goal, percent)


@click.command()
@click.option("--phones", default=1, show_default=True)
@click.option("--first", default=0, show_default=True, help="Number of the first phone.")
@click.option("--days", default=3.0, show_default=True)
@click.option("--seed", default=0, show_default=True)
@click.option("--jobs", default=1, show_default=True)
@click.option("--thermometer/--no-thermometer", default=True, help="Withhold the temperatures.")
@click.option(
    "--keep",
    type=click.Path(file_okay=False, path_type=Path),
    help="Directory where each life that has ended is kept, and from which a stopped run goes on.",
)
def main(phones: int, first: int, jobs: int, keep: Path | None, **how: Any) -> None:
    """Print the tables."""
    if keep:
        keep.mkdir(parents=True, exist_ok=True)
    lives = measured(range(first, first + phones), Conditions(**how), jobs, keep)
    rows = np.concatenate([life.rows for life in lives])
    shares = (f"{c.what}: {c.value:.3g} {c.unit}" for c in _costs([life.cost for life in lives]))
    for text in (*(life.line for life in lives), "", *table(rows), "", *shares):
        click.echo(text)


if __name__ == "__main__":
    main()
