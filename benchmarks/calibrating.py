"""Item 1: a day in memory to a calibration, beside scikit-digital-health's; CSV; growth with length."""

from __future__ import annotations

import json
import subprocess
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from peers import peer
from subject import FOLDER, LOCAL_G, RATE_HZ, Day, day, error_mg, flat_file
from timing import Row, ratio, rounds

from stillcal.calib_core import accelerometer
from stillcal.calib_core.engine import Engine
from stillcal.calib_core.engine_state import EngineSettings
from stillcal.calib_core.events import End
from stillcal.calib_core.model import SensorModel
from stillcal.calib_core.rests import force_uncertainties, forces
from stillcal.calib_core.schedule import ScheduleSettings
from stillcal.calib_core.stationary import StationaryDetector
from stillcal.replay.formats.writer import TraceWriter
from stillcal.replay.trace import open_trace

BLOCK = 1 << 15
LENGTHS_S = {"1 min": 60, "10 min": 600, "1 h": 3600, "6 h": 21600, "1 day": 86400, "7 days": 604800}
LONGEST = {"30 days": 30 * 86400}


def by_detector(subject: Day) -> SensorModel:
    """Find all rests and fit them once, as the peers do."""
    detector, found = StationaryDetector(), []
    for first in range(0, len(subject.accelerometer), BLOCK):
        found += detector.feed(subject.accelerometer[first : first + BLOCK])
    found += detector.finish()
    return accelerometer.fit(forces(found), force_uncertainties(found), LOCAL_G).model


def by_engine(subject: Day, watch: str) -> SensorModel:
    """Let the daemon's engine live through the day."""
    settings = ScheduleSettings(watch=watch, gravity=LOCAL_G)  # type: ignore[arg-type]
    engine = Engine(EngineSettings(schedule=settings))
    for first in range(0, len(subject.accelerometer), BLOCK):
        engine.feed(subject.accelerometer[first : first + BLOCK])
    engine.feed(End(float(subject.accelerometer.t[-1])))
    record = engine.state.record
    assert record is not None and record.accelerometer is not None
    return record.accelerometer.model


def by_skdh(subject: Day, in_g: np.ndarray) -> SensorModel:
    """Run CalibrateAccelerometer (van Hees et al. 2014) on all of the same samples, (n, 3) in its unit."""
    skdh = peer("skdh.preprocessing")
    assert skdh is not None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = skdh.CalibrateAccelerometer(min_hours=24).predict(
            time=subject.accelerometer.t, accel=in_g, fs=len(in_g) / 86401.0, apply=False
        )
    return SensorModel.of(np.diag(found["scale"]), -np.asarray(found["offset"]) * LOCAL_G)


def run(quick: bool) -> Iterator[Row]:
    """Yield the rows of item 1."""
    subject = day()
    cases = {
        "detector and one fit, continuous": lambda: by_detector(subject),
        "engine, continuous": lambda: by_engine(subject, "continuous"),
        "engine, duty-cycled": lambda: by_engine(subject, "auto"),
    }
    has_peer = peer("skdh") is not None
    in_g = np.asarray(subject.accelerometer.xyz / LOCAL_G)
    timed = rounds(cases | ({"skdh": lambda: by_skdh(subject, in_g)} if has_peer else {}), 2 if quick else 5)
    n = len(subject.accelerometer)
    for name in cases:
        own = timed[name]
        goal = 10.0 if "duty" in name else 2.0
        versus = ratio(own, timed["skdh"]) if has_peer else None
        yield Row(
            "1",
            f"a day at 50 Hz from memory: {name}",
            n / own.best / 1e6,
            "million samples/s",
            "scikit-digital-health",
            versus,
            f"{goal:g} times its speed, < 0.1 mg",
            None if versus is None else versus[0] >= goal and error_mg(own.answer) < 0.1,
            f"{error_mg(own.answer):.3f} mg left",
        )
    if has_peer:
        own = timed["skdh"]
        accuracy = f"{error_mg(own.answer):.2f} mg left"
        yield Row(
            "1", "the same: scikit-digital-health", n / own.best / 1e6, "million samples/s", accuracy=accuracy
        )
    yield from _from_csv(subject, quick)
    yield from _growth(quick)


def _from_csv(subject: Day, quick: bool) -> Iterator[Row]:
    """Read an hour of both sensors from CSV, beside pandas' parser, which checks nothing."""
    file, n = FOLDER / "hour.csv", int(3600 * RATE_HZ)
    with TraceWriter(file, gyroscope=True, temperature=False, arrival=False) as writer:
        writer.write(subject.accelerometer[:n], subject.gyroscope[:n])
    pandas = peer("pandas")
    cases = {"ours": lambda: sum(len(c.accelerometer) for c in open_trace(file).chunks())}
    if pandas is not None:
        cases["pandas"] = lambda: len(pandas.read_csv(file))
    timed = rounds(cases, 3 if quick else 9)
    versus = ratio(timed["ours"], timed["pandas"]) if pandas is not None else None
    rows = timed["ours"].answer / timed["ours"].best / 1e6
    yield Row("1", "reading CSV, seven columns", rows, "million rows/s", "pandas", versus)


def _growth(quick: bool) -> Iterator[Row]:
    """Time and peak memory of the engine against the length of what it is fed, a process each."""
    flat_file()
    for watch, name, lengths in (
        ("continuous", "continuous", LENGTHS_S),
        ("auto", "duty-cycled", LENGTHS_S if quick else LENGTHS_S | LONGEST),
    ):
        found = {length: _taken(seconds, watch) for length, seconds in lengths.items()}
        long = [v for k, v in found.items() if lengths[k] >= 3600]
        slope = np.polyfit(np.log([v["samples"] for v in long]), np.log([v["seconds"] for v in long]), 1)[0]
        last, peaks = list(lengths)[-1], [v["peak_mb"] for v in found.values()]
        what = f"time against length, 1 h to {last}, {name}: exponent"
        yield Row("1", what, float(slope), "", goal="1", met=float(slope) < 1.1, more=found)
        what, first = (
            f"peak memory after {last}, {name}",
            f"{peaks[0]:.0f} MB after 1 min, {peaks[2]:.0f} after 1 h",
        )
        flat = peaks[-1] < 1.1 * peaks[4]
        yield Row("1", what, peaks[-1], "MB", accuracy=first, goal="flat from a day on", met=flat)


def _taken(seconds: int, watch: str) -> dict[str, float]:
    command = [sys.executable, str(Path(__file__).with_name("length.py")), str(seconds), watch]
    said = subprocess.run(command, check=True, capture_output=True, text=True)
    found: dict[str, float] = json.loads(said.stdout)
    return found
