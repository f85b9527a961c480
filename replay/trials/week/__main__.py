"""A simulated week through the daemon's engine, counted: `python -m stillcal.replay.trials.week`.

As fast as it goes, in one process, chunk by chunk as they would arrive, with what befalls a phone's clock on
the way (clock.py) and store and state kept as the daemon keeps them: what was calibrated, checked and
zeroed and why; how far the published calibration was from the truth at every hour; what of the samples was
used; and how much memory a further day costs. Exit code 1 where a bar is not met.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import click
import msgspec
import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.calibration.record import CalibrationRecord
from stillcal.calib_core.engine.actions import Action, Level, Log, Publish, Reject
from stillcal.calib_core.engine.engine import Engine
from stillcal.calib_core.engine.state import Counters
from stillcal.calib_core.gravity import STANDARD
from stillcal.calib_core.streams.events import End
from stillcal.daemon.service import saved_state
from stillcal.daemon.service.phone_clock import PhoneClock
from stillcal.daemon.store.store import Store
from stillcal.daemon.system.log import entry
from stillcal.daemon.system.memory import resident_bytes
from stillcal.replay.phone import Phone, Simulation, Truth, load_phone, load_scenario, simulate
from stillcal.replay.trials.week.clock import MISHAPS, Mishap, through_clock

HOUR_S, DAY_S = 3600.0, 86400.0
MG = STANDARD / 1000
FORCE_BAR_MG, RATE_BAR_DEG_S, DUTY_BAR = 2.0, 0.01, 0.05
DIRECTIONS = 500
KEPT = 2


HOUR = np.dtype(
    [(name, np.float64) for name in ("t", "force_mg", "rate_deg_s", "off_grid_s")]
    + [(name, np.int64) for name in ("read", "offered", "rss", "state", "files")]
)
"""How things stood at time t (s).

force_mg, rate_deg_s: what the published calibration was off by, NaN before there is one (see `force_error`,
`rate_error`). off_grid_s: how far the next check is from its grid. read, offered: accelerometer samples so
far. rss: bytes of memory in use; state: bytes of the saved state; files:
in the folder of store and state.
"""


class Week:
    """What came of it. Memory is being measured, so nothing here grows with time.

    hours: of dtype HOUR, so far. first: the first KEPT lines of the log of each kind and occasion.
    """

    def __init__(self, duration: float, every_s: float) -> None:
        self.duration, self.asked_s, self.counters = duration, 0.0, Counters()
        self._hours = np.zeros(int(duration // every_s), HOUR)
        self._filled = 0
        self._lines: dict[tuple[str, object], list[Log]] = {}

    @property
    def hours(self) -> NDArray[np.void]:
        """The hours so far."""
        return self._hours[: self._filled]

    @property
    def first(self) -> list[Log]:
        """The first lines of each kind and, where there is one, occasion; in order."""
        return sorted((line for lines in self._lines.values() for line in lines), key=lambda line: line.t)

    @property
    def duty(self) -> float:
        """Share of the samples that was used."""
        return float(self.hours["read"][-1] / self.hours["offered"][-1])

    def median(self, name: str) -> float:
        """Return the median of an error over the hours since there was a calibration."""
        known = self.hours[name][np.isfinite(self.hours[name])]
        return float(np.median(known)) if known.size else float("nan")

    def add(self, hour: tuple[float, ...]) -> None:
        """Take one hour's figures, in HOUR's order; those beyond the duration are left out."""
        if self._filled < len(self._hours):
            self._hours[self._filled] = hour
            self._filled += 1

    def hear(self, actions: Iterable[Action]) -> None:
        """Keep the first lines of the log of each kind; debugging is not for the log."""
        for line in actions:
            if isinstance(line, Log) and line.level is not Level.DEBUG:
                lines = self._lines.setdefault((line.what, line.fields.get("occasion")), [])
                if len(lines) < KEPT:
                    lines.append(line)


@dataclass(frozen=True, slots=True)
class Slope:
    """What a day adds, with its standard error; distinct: from zero, at the 5 % level."""

    value: float
    error: float
    distinct: bool


def live(simulation: Simulation, every_s: float = HOUR_S, mishaps: Sequence[Mishap] = ()) -> Iterator[Week]:
    """Let the engine live through it; yield the same growing account every `every_s` and at the end."""
    engine, week, clock = Engine(), Week(simulation.duration, every_s), PhoneClock()
    offered, due = 0, every_s
    with (
        tempfile.TemporaryDirectory(prefix="stillcal-") as folder,
        Store(Path(folder) / "store.json") as store,
    ):
        for chunk, items in through_clock(simulation.chunks(), clock, mishaps):
            offered += len(chunk.accelerometer)
            week.hear(_kept(engine.feed(*items), store))
            if chunk.t_end >= due:
                due += every_s
                week.add(_looked(chunk.t_end, engine, offered, simulation.truth, store.path))
                yield _counted(week, engine)
        week.hear(engine.feed(End(clock.newest)))
    yield _counted(week, engine)


def _kept(actions: list[Action], store: Store) -> list[Action]:
    """Write what is to be stored, and return what was to be done."""
    for action in actions:
        if isinstance(action, Publish):
            store.publish(action.record, action.reason, action.t)
        elif isinstance(action, Reject):
            store.reject(action.record, action.reason, action.t)
    return actions


def force_error(record: CalibrationRecord, truth: Truth) -> float:
    """Return the mean length of the error vector over all directions of gravity, mg.

    The rotation common to all axes, which gravity cannot show, is left in.
    """
    if record.accelerometer is None:
        return float("nan")
    up = np.random.default_rng(0).normal(size=(DIRECTIONS, 3))
    force = 1000 * MG * up / np.linalg.norm(up, axis=1, keepdims=True)
    raw = force @ truth.accelerometer.forward.T + truth.accelerometer.bias
    return float(np.linalg.norm(record.accelerometer.model.apply(raw) - force, axis=1).mean() / MG)


def rate_error(record: CalibrationRecord, truth: Truth) -> float:
    """Return what the calibrated gyroscope shows when nothing turns, deg/s; wander and noise left out."""
    if record.gyroscope is None or truth.gyroscope is None:
        return float("nan")
    return float(np.degrees(np.linalg.norm(record.gyroscope.model.apply(truth.gyroscope.bias))))


def daily_slope(t: Array, values: Array) -> Slope:
    """Fit a line to the means of whole days, the first left out, in which buffers and pools fill.

    t (n,): s; values (n,). Means, because neighbouring hours are not independent. NaN below three days.
    """
    from scipy import stats  # noqa: PLC0415 - half a second that nobody else here needs

    day = (t // DAY_S).astype(int)
    days = np.unique(day[day > 0])
    means = np.array([values[day == d].mean() for d in days])
    if len(days) < 3:
        return Slope(float("nan"), float("nan"), False)
    fit = stats.linregress(days, means)
    limit = stats.t.ppf(0.975, len(days) - 2) * fit.stderr
    return Slope(float(fit.slope), float(fit.stderr), bool(abs(fit.slope) > limit))


def _looked(t: float, engine: Engine, offered: int, truth: Truth, store: Path) -> tuple[float, ...]:
    data = saved_state.encode(saved_state.SavedState(engine.state))
    saved_state.save(saved_state.state_path(store), data)
    state, interval = engine.state, engine.settings.schedule.check_interval_s
    off = 0.0
    if state.next_check is not None and state.began is not None:
        off = abs((state.next_check - state.began + interval / 2) % interval - interval / 2)
    record = state.record
    errors = (np.nan, np.nan) if record is None else (force_error(record, truth), rate_error(record, truth))
    read = engine.ledger.accel_samples
    files = len(list(store.parent.iterdir()))
    return t, *errors, off, read, offered, resident_bytes(), len(data), files


def _counted(week: Week, engine: Engine) -> Week:
    week.counters, week.asked_s = engine.state.counters, engine.ledger.asked_s
    return week


# Printing


def _day_line(week: Week) -> str:
    last, counters = week.hours[-1], week.counters
    return (
        f"{last['t'] / DAY_S:4.0f} {counters.calibrations:8} {counters.rejected:8} {counters.checks:7}"
        f" {counters.zeroings:7} {last['force_mg']:8.3f} {last['rate_deg_s']:9.5f}"
        f" {last['read'] / last['offered']:7.2%} {last['rss'] / 2**20:8.2f} {last['state'] / 1024:10.0f}"
    )


def _verdicts(week: Week) -> list[tuple[str, str, bool]]:
    """Return each figure that has a bar: its name, itself, and whether the bar is met."""
    rss = daily_slope(week.hours["t"] - HOUR_S / 2, week.hours["rss"] / 1024)
    off_grid = week.hours["off_grid_s"].max()
    files = week.hours["files"][[min(23, len(week.hours) - 1), -1]]
    force, rate = week.median("force_mg"), week.median("rate_deg_s")
    return [
        (
            "force, median error",
            f"{force:.3f} mg (bar {FORCE_BAR_MG} mg)",
            force < FORCE_BAR_MG,
        ),
        (
            "rate at rest, median error",
            f"{rate:.5f} deg/s (bar {RATE_BAR_DEG_S} deg/s)",
            rate < RATE_BAR_DEG_S,
        ),
        (
            "samples used",
            f"{week.duty:.2%} (bar {DUTY_BAR:.0%}); sensors asked for {week.asked_s / week.duration:.2%}",
            week.duty <= DUTY_BAR,
        ),
        (
            "memory",
            f"{rss.value:+.1f} +- {rss.error:.1f} KiB a day, first day left out",
            np.isfinite(rss.value) and not rss.distinct,
        ),
        ("checks off their grid", f"{off_grid:.6f} s at most", off_grid < 1e-3),
        (
            "files of store and state",
            f"{files[0]} after a day, {files[1]} at the end",
            bool(files[1] <= files[0]),
        ),
    ]


@click.command()
@click.option("--scenario", default="week", show_default=True, help="A ready scenario, or a TOML file.")
@click.option("--phone", default="typical", show_default=True, help="A ready phone, or a TOML file.")
@click.option("--seed", "seeds", multiple=True, type=int, default=(1,), show_default=True)
@click.option("--rate", default=0.0, help="Hz of both sensors, in place of the phone's own.")
@click.option("--undisturbed", is_flag=True, help="Let nothing befall the phone's clock.")
def main(scenario: str, phone: str, seeds: tuple[int, ...], rate: float, undisturbed: bool) -> None:
    """Live a simulated week for each seed and print its figures; exit code 1 where a bar is not met."""
    chosen = load_phone(phone) if rate == 0.0 else at_rate(load_phone(phone), rate)
    mishaps = () if undisturbed else MISHAPS
    met = [_shown(scenario, simulate(load_scenario(scenario), chosen, seed), seed, mishaps) for seed in seeds]
    sys.exit(not all(met))


def at_rate(phone: Phone, rate_hz: float) -> Phone:
    """Return a phone with both its sensors at another rate, Hz."""
    other = msgspec.structs.replace
    gyro = phone.gyro and other(phone.gyro, rate_hz=rate_hz)
    return other(phone, accel=other(phone.accel, rate_hz=rate_hz), gyro=gyro)


def _shown(scenario: str, simulation: Simulation, seed: int, mishaps: Sequence[Mishap]) -> bool:
    """Live one week and print its figures; say whether every bar is met."""
    if simulation.duration < HOUR_S:
        raise click.UsageError(f"{scenario} lasts {simulation.duration:.0f} s: give one of an hour at least")
    click.echo(f"{scenario}, seed {seed}: {simulation.duration / DAY_S:.2f} days")
    click.echo(" day  calibr. rejected  checks zeroed       mg     deg/s    used  RSS MiB  state KiB")
    shown = 0
    for week in live(simulation, mishaps=mishaps):
        if (days := len(week.hours) // 24) > shown:
            shown = days
            click.echo(_day_line(week))
    for name, figure, met in (verdicts := _verdicts(week)):
        click.echo(f"{name:27} {figure}: {'met' if met else 'NOT MET'}")
    click.echo(f"\nThe first {KEPT} lines of the log of each kind:")
    for line in week.first:
        click.echo(f"  {line.t / HOUR_S:7.2f} h  {entry(line.what, line.why, line.fields)}")
    return all(met for _, _, met in verdicts)


if __name__ == "__main__":
    main()
