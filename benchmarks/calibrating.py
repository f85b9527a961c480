"""Item 1: a day in memory to a calibration, beside scikit-digital-health's; the rest: recordings.py."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator

import numpy as np
from peers import peer
from recordings import from_csv, growth, whole_day, whole_process
from subject import LOCAL_G, Day, day, error_mg
from timing import Row, ratio, rounds

from stillcal.calib_core.accelerometer import fit as accelerometer
from stillcal.calib_core.engine.engine import Engine
from stillcal.calib_core.engine.settings import EngineSettings, ScheduleSettings
from stillcal.calib_core.model import SensorModel
from stillcal.calib_core.static.detector import StationaryDetector
from stillcal.calib_core.static.rest import force_uncertainties, forces
from stillcal.calib_core.streams.events import End

BLOCK = 1 << 15
TOLERANCES = (1e-10, 1e-14)
"""Of the peer's iteration: as shipped, where it stops early on so many samples, and converged."""


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


def by_skdh(subject: Day, in_g: np.ndarray, tolerance: float) -> SensorModel:
    """Run CalibrateAccelerometer (van Hees et al. 2014) on all of the same samples, (n, 3) in its unit."""
    skdh = peer("skdh.preprocessing")
    assert skdh is not None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = skdh.CalibrateAccelerometer(min_hours=24, tol=tolerance).predict(
            time=subject.accelerometer.t, accel=in_g, fs=len(in_g) / 86401.0, apply=False
        )
    return SensorModel.of(np.diag(found["scale"]), -np.asarray(found["offset"]) * LOCAL_G)


def run(quick: bool) -> Iterator[Row]:
    """Yield the rows of item 1."""
    yield from _from_memory(quick)
    yield from from_csv(quick)
    yield from whole_day(quick)
    yield from whole_process(quick)
    yield from growth(quick)


def _from_memory(quick: bool) -> Iterator[Row]:
    """Calibrate from a day's accelerometer, beside the peer as it is shipped, which is its fastest."""
    subject, peers = day(), dict[str, Callable[[], SensorModel]]()
    cases = {
        "detector and one fit, continuous": lambda: by_detector(subject),
        "engine, continuous": lambda: by_engine(subject, "continuous"),
        "engine, duty-cycled": lambda: by_engine(subject, "auto"),
    }
    in_g = np.asarray(subject.accelerometer.xyz / LOCAL_G)
    if peer("skdh") is not None:
        peers = {f"tol={t:g}": lambda t=t: by_skdh(subject, in_g, t) for t in TOLERANCES}
    timed = rounds(cases | peers, 2 if quick else 5)
    n = len(subject.accelerometer)
    for name in cases:
        own, error = timed[name], error_mg(timed[name].answer)
        goal = 10.0 if "duty" in name else 2.0
        versus = ratio(own, timed[next(iter(peers))]) if peers else None
        yield Row(
            "1",
            f"a day at 50 Hz from memory: {name}",
            own.rate(n / 1e6),
            "million samples/s",
            "scikit-digital-health",
            versus,
            f"{goal:g} times its speed, < 0.1 mg",
            None if versus is None else versus[0] >= goal and error < 0.1,
            f"{error:.3f} mg left",
            versus and versus[0] / goal,
        )
    for name in peers:
        own, shipped = timed[name], " (as shipped)" if name == next(iter(peers)) else ""
        yield Row(
            "1",
            f"the same: scikit-digital-health, {name}{shipped}",
            own.rate(n / 1e6),
            "million samples/s",
            accuracy=f"{error_mg(own.answer):.2f} mg left",
        )
    yield _limit(in_g, {name: timed[name].median for name in cases})


def _limit(in_g: np.ndarray, taken: dict[str, float]) -> Row:
    """Copy the same samples, which nothing that reads them once can beat by much; taken: s, of ours."""
    copied = rounds({"copy": in_g.copy}, 5)["copy"]
    times = "; ".join(f"{name}: {seconds / copied.median:.0f}" for name, seconds in taken.items())
    return Row(
        "1",
        "copying the same samples: the memory's limit",
        copied.rate(len(in_g) / 1e6),
        "million samples/s",
        accuracy=f"{in_g.nbytes / copied.median / 1e9:.1f} GB/s; how many times as long ours take: {times}",
    )
