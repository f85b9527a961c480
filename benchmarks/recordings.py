"""Item 1, from files: CSV through parser and engine, a recording as a whole process, growth with length."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from msgspec.structs import replace as replace_struct
from peers import peer
from subject import FOLDER, RATE_HZ, day, flat_file
from timing import Row, Timed, middle, ratio, rounds

from stillcal.calib_core.engine.engine import Engine
from stillcal.calib_core.engine.settings import EngineSettings
from stillcal.replay.formats.claims import Claims
from stillcal.replay.formats.conversion.by_name import writer_class
from stillcal.replay.formats.trace import open_trace
from stillcal.replay.phone import load_phone, load_scenario, simulate
from stillcal.replay.runner import replay

LENGTHS_S = {"1 min": 60, "10 min": 600, "1 h": 3600, "6 h": 21600, "1 day": 86400, "7 days": 604800}
LONGEST = {"30 days": 30 * 86400}
FOREIGN_S = 0.9
"""What a C++ tool is said to take for the Xsens recording on such a machine; not measured here."""


def from_csv(quick: bool) -> Iterator[Row]:
    """Read an hour of both sensors, beside parsers with the same checks; then calibrate from it."""
    file, table, n, subject = FOLDER / "hour.csv", FOLDER / "hour.parquet", int(3600 * RATE_HZ), day()
    pandas, arrow = peer("pandas"), peer("pyarrow.csv")
    for path in (file, *([] if arrow is None else [table])):
        with writer_class(path)(path, gyroscope=True, temperature=False, arrival=False) as writer:
            writer.write(subject.accelerometer[:n], subject.gyroscope[:n])
    cases: dict[str, Callable[[], int]] = {"reading": lambda: _read(file)}
    cases |= {watch: partial(_replayed, file, watch) for watch in ("continuous", "auto")}
    if pandas is not None:
        cases["pandas"] = lambda: _checked(pandas.read_csv(file, dtype=np.float64).to_numpy().T)
    if arrow is not None:
        cases |= {"pyarrow": lambda: _checked(_by_arrow(arrow, file)), "Parquet": lambda: _read(table)}
        cases["decoding"] = lambda: _decoded(table)
    timed = rounds(cases, 2 if quick else 7)
    samples, what = timed["reading"].answer / 1e6, "reading CSV, seven columns"
    for name in ("pandas", "pyarrow"):
        yield _beside(what, timed["reading"], samples, (f"{name}, the same checks", timed.get(name)), 1.0)
    if arrow is not None:
        what, limit = "reading Parquet, seven columns", timed["decoding"]
        yield _beside(what, timed["Parquet"], samples, ("our CSV", timed["reading"]), 10.0)
        said = f"the limit: ours takes {ratio(limit, timed['Parquet'])[0]:.3g} times as long"
        what, versus = "reading Parquet: decoding alone, by Arrow", ratio(limit, timed["reading"])
        yield Row("1", what, limit.rate(samples), "million rows/s", "our CSV", versus, accuracy=said)
    for watch, name in (("continuous", "continuous"), ("auto", "duty-cycled")):
        what = f"an hour of both sensors from CSV through the engine, {name}"
        yield Row("1", what, timed[watch].rate(samples), "million samples/s")


def _beside(what: str, timed: Timed, count: float, peer: tuple[str, Timed | None], least: float) -> Row:
    """Return a row that is met where the peer takes `least` times as long."""
    name, its = peer
    versus = None if its is None else ratio(timed, its)
    met, margin = (None, None) if versus is None else (versus[0] >= least, versus[0] / least)
    goal = "at least as fast" if least == 1.0 else f"{least:g} times as fast"
    return Row("1", what, timed.rate(count), "million rows/s", name, versus, goal, met, margin=margin)


def _by_arrow(arrow: Any, file: Path) -> list[np.ndarray]:
    """Return the columns of a CSV file by Arrow's reader, which names the row of a cell that is no number."""
    names = file.open().readline().strip().split(",")
    options = arrow.ConvertOptions(column_types=dict.fromkeys(names, "float64"))
    table = arrow.read_csv(file, arrow.ReadOptions(use_threads=False), convert_options=options)
    return [column.to_numpy() for column in table.columns]


def _checked(columns: Sequence[np.ndarray]) -> int:
    """Check t and both sensors' axes as reading does, with the least that can, and count the samples.

    Raises ValueError naming the first line whose stamp runs back or is none, or that lacks some of a sensor's
    axes; all of them may be empty.
    """
    t, count = columns[0], 0
    bad = ~np.isfinite(t)
    bad[1:] |= t[1:] < t[:-1]
    for axes in (columns[1:4], columns[4:7]):
        x, y, z = (np.isfinite(axis) for axis in axes)
        whole = x & y & z
        bad |= ~(whole | (np.isnan(axes[0]) & np.isnan(axes[1]) & np.isnan(axes[2])))
        count += int(np.count_nonzero(whole))
    if bad.any():
        raise ValueError(f"line {int(bad.argmax()) + 2}")
    return count


def _decoded(table: Path) -> int:
    """Decode a Parquet file with Arrow on one thread and do nothing with it."""
    parquet = peer("pyarrow.parquet")
    assert parquet is not None
    return len(parquet.read_table(table, use_threads=False))


def _read(file: Path) -> int:
    """Return how many rows there are, one for each sample of each sensor."""
    return sum(
        len(stream)
        for chunk in open_trace(file).chunks()
        for stream in (chunk.accelerometer, chunk.gyroscope or ())
    )


def whole_day(quick: bool) -> Iterator[Row]:
    """Simulate the scenario `day` (100 Hz, both sensors) into Parquet, and replay it from there."""
    if peer("pyarrow") is None:
        return
    file, phone = FOLDER / "day.parquet", load_phone("typical")
    if quick:
        phone = replace_struct(phone, accel=_at(phone.accel), gyro=_at(phone.gyro))
    claims = msgspec.convert(phone.claimed(), Claims)

    def made() -> None:
        simulation = simulate(load_scenario("day"), phone, 0)
        with writer_class(file)(file, temperature=True, arrival=True, claims=claims) as writer:
            for chunk in simulation.chunks():
                writer.write(chunk.accelerometer, chunk.gyroscope, chunk.events)

    cases = {"made": made, "continuous": lambda: _replayed(file, "continuous")}
    timed = rounds(cases | {"auto": lambda: _replayed(file, "auto")}, 1 if quick else 3)
    rate, megabytes = "10 Hz" if quick else "100 Hz", file.stat().st_size / 1e6
    for case, what, most in (
        ("made", f"simulate a day at {rate} into Parquet", 15.0),
        ("continuous", f"a day at {rate} replayed from Parquet, continuous", 3.0),
        ("auto", f"a day at {rate} replayed from Parquet, duty-cycled", 3.0),
    ):
        taken = timed[case].spread(1.0)
        stored = f"{megabytes:.0f} MB on disk" if case == "made" else ""
        met = None if quick else taken[0] <= most and (case != "made" or megabytes <= 250)
        goal = f"{most:g} s{' and 250 MB' if case == 'made' else ''}"
        yield Row("1", what, taken, "s", goal=goal, met=met, accuracy=stored, margin=most / taken[0])


def _at(sensor: Any) -> Any:
    return None if sensor is None else replace_struct(sensor, rate_hz=10.0)


def _replayed(file: Path, watch: str) -> int:
    settings = EngineSettings()
    schedule = replace(settings.schedule, watch=watch)  # type: ignore[arg-type]
    engine = Engine(replace(settings, schedule=schedule))
    return replay(open_trace(file).chunks(), engine, lambda _: None).samples


def whole_process(quick: bool) -> Iterator[Row]:
    """Calibrate the Xsens recording from the shell: start, imports, parsing and both fits. By the clock."""
    default = Path(__file__).resolve().parents[2] / "shared" / "data"
    file = Path(os.environ.get("STILLCAL_DATA", default)) / "imu_tk" / "xsens_acc.mat.gz"
    what, goal = "the Xsens recording, whole process, by the clock", f"{FOREIGN_S:g} s, a C++ tool's"
    if not file.is_file():
        yield Row("1", what, float("nan"), "s", goal=goal, accuracy="not measured: set STILLCAL_DATA")
        return
    command = [str(Path(sys.executable).with_name("stillcal")), "replay", str(file), "--format", "imu_tk"]
    taken, said = [], ""
    for _ in range(4 if quick else 12):
        began = time.perf_counter()
        said = subprocess.run(command, check=True, capture_output=True, text=True).stdout
        taken.append(time.perf_counter() - began)
    spread = middle(np.array(taken[1:]))
    rest = " ".join(next(line for line in said.splitlines() if "at rest" in line).split("rest", 1)[1].split())
    met, margin = spread[0] <= FOREIGN_S, FOREIGN_S / spread[0]
    yield Row("1", what, spread, "s", goal=goal, met=met, accuracy=f"at rest {rest}", margin=margin)


def growth(quick: bool) -> Iterator[Row]:
    """Time and peak memory of the engine against the length of what it is fed, a process each."""
    flat_file()
    lengths = LENGTHS_S if quick else LENGTHS_S | LONGEST
    last = list(lengths)[-1]
    for watch, name in (("continuous", "continuous"), ("auto", "duty-cycled")):
        found = {length: _taken(seconds, watch) for length, seconds in lengths.items()}
        slope, early = _slope(found, 86400), _slope(found, 3600)
        peaks = [v["peak_mb"] for v in found.values()]
        yield Row(
            "1",
            f"time against length, 1 day to {last}, {name}: exponent",
            slope,
            "",
            goal="1",
            met=slope < 1.1,
            accuracy=f"from 1 h on {early:.2f}, of hours unlike each other",
            margin=1.0 / slope,
            more=found,
        )
        yield Row(
            "1",
            f"peak memory after {last}, {name}",
            peaks[-1],
            "MB",
            accuracy=f"{peaks[0]:.0f} MB after 1 min, {peaks[2]:.0f} after 1 h, {peaks[4]:.0f} after 1 day",
            goal="flat from a day on",
            met=peaks[-1] < 1.1 * peaks[4],
        )


def _slope(found: dict[str, dict[str, float]], least_s: float) -> float:
    """Return the exponent of time against length, of the lengths from `least_s` on."""
    long = [v for v in found.values() if v["samples"] >= least_s * RATE_HZ]
    log = [np.log([v[k] for v in long]) for k in ("samples", "seconds")]
    return float(np.polyfit(log[0], log[1], 1)[0])


def _taken(seconds: int, watch: str) -> dict[str, float]:
    command = [sys.executable, str(Path(__file__).with_name("length.py")), str(seconds), watch]
    said = subprocess.run(command, check=True, capture_output=True, text=True)
    found: dict[str, float] = json.loads(said.stdout)
    return found
