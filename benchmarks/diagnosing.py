"""Item 6: the diagnosis of an hour, of a table of rests and of a whole day, and how time and memory grow."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import tracemalloc
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from subject import LOCAL_G, Day, day
from timing import Row, rounds

from stillcal.calib_core.arrays import frozen
from stillcal.calib_core.diagnosis.diagnose import diagnose
from stillcal.calib_core.static.rest import RestState
from stillcal.replay.diagnosis.condense import condensed
from stillcal.replay.diagnosis.rest_table import diagnose_rests
from stillcal.replay.formats.claims import Claims
from stillcal.replay.formats.trace import Recording

MINUTES = (15, 30, 60, 120, 240)
ROWS = (300, 3000, 11000)
HOURS = (4, 8, 24)
HOUR_S, TABLE_S = 3.0, 20.0
"""Goals: s of an hour at 50 Hz, and of the largest table."""

DAY_S, DAY_MB = 40.0, 600.0
"""Goals: s of processor and MB of memory at most of a day at 100 Hz, command and reading with it."""


def run(quick: bool) -> Iterator[Row]:
    """Yield the row of item 6."""
    subject = day()
    taken = {}
    for minutes in MINUTES[:3] if quick else MINUTES:
        part = [s.between(0.0, 60.0 * minutes) for s in (subject.accelerometer, subject.gyroscope)]
        count = 5 if minutes == 60 and not quick else 1
        taken[minutes] = rounds({"ours": lambda p=part: diagnose(p[0], p[1])}, count)["ours"]
    usual = [t.median for t in taken.values()]
    slope = np.polyfit(np.log(list(taken)), np.log(usual), 1)[0]
    yield Row(
        "6",
        "diagnosis of 1 h at 50 Hz, both sensors",
        taken[60].spread(1.0),
        "s",
        accuracy=f"grows as length to the {slope:.2f}",
        more={f"{m} min": {"seconds": s} for m, s in zip(taken, usual, strict=True)},
    ).at_most(HOUR_S, taken[60].median)
    yield _tables(ROWS[:2] if quick else ROWS)
    yield _memory(subject, HOURS[:2] if quick else HOURS)
    yield from _whole("tables" if quick else "day")


def _tables(rows: tuple[int, ...]) -> Row:
    """Return how the diagnosis of a table of rests grows with its rows."""
    taken = {n: rounds({"ours": lambda n=n: diagnose_rests(_rests(n), "table")}, 1)["ours"] for n in rows}
    usual = [t.median for t in taken.values()]
    row = Row(
        "6",
        f"diagnosis of a table of {rows[-1]} rests",
        usual[-1],
        "s",
        accuracy=f"{usual[-1] / usual[0]:.2g} times as long as of {rows[0]} rests",
        more={f"{n} rests": {"seconds": s} for n, s in zip(taken, usual, strict=True)},
    )
    return row.at_most(TABLE_S, usual[-1]) if rows[-1] == ROWS[-1] else row


def _rests(n: int) -> list[RestState]:
    """Return rests in six attitudes, whose bias follows temperature."""
    rng = np.random.default_rng(0)
    up = np.vstack([np.eye(3), -np.eye(3)])[rng.integers(0, 6, n)]
    warm = 25.0 + 5.0 * np.sin(np.arange(n) / n * 20.0)
    force = LOCAL_G * up + rng.normal(size=(n, 3)) * 0.002 + 1e-3 * (warm - 25.0)[:, None]
    sd = frozen(np.full(3, 0.002))
    return [
        RestState(
            t_start=60.0 * i,
            t_end=60.0 * i + 20.0,
            n=1000,
            specific_force=frozen(force[i]),
            force_sd=sd,
            force_uncertainty=sd,
            level=0.002,
            rate=None,
            rate_sd=None,
            rate_uncertainty=None,
            rate_level=None,
            temperature=float(warm[i]),
        )
        for i in range(n)
    ]


def _memory(subject: Day, hours: tuple[int, ...]) -> Row:
    """Return what is held of a recording beside its samples in memory, by its length."""
    peaks = {}
    for h in hours:
        accel, gyro = (s.between(0.0, 3600.0 * h) for s in (subject.accelerometer, subject.gyroscope))
        recording = Recording(accel, gyro, [], Claims(), [], "day")
        tracemalloc.start()
        held = condensed(recording)
        peaks[h] = tracemalloc.get_traced_memory()[1] / 1e6
        tracemalloc.stop()
        samples = len(held.accelerometer)
    return Row(
        "6",
        f"held of {hours[-1]} h at 50 Hz beside its samples",
        peaks[hours[-1]],
        "MB",
        accuracy=f"{samples} samples a sensor are kept",
        more={f"{h} h": {"peak_mb": m} for h, m in peaks.items()},
    )


def _whole(scenario: str) -> Iterator[Row]:
    """Yield what the command takes that diagnoses a simulated recording, at 100 Hz, from its Parquet."""
    with tempfile.TemporaryDirectory() as folder:
        file, answer = (str(Path(folder) / name) for name in ("recording.parquet", "answer.json"))
        made, _ = _spent("simulate", scenario, "--out", file, "--quiet")
        taken, peak = _spent("diagnose", file, "--json", answer, "--quiet")
    longer = f"{taken / made:.2g} times as long as to simulate it"
    what = f"diagnosis of `simulate {scenario}` at 100 Hz"
    processor = Row("6", f"{what}, processor", taken, "s", accuracy=longer)
    memory = Row("6", f"{what}, peak memory", peak, "MB")
    judged = scenario == "day"
    yield processor.at_most(DAY_S, taken) if judged else processor
    yield memory.at_most(DAY_MB, peak) if judged else memory


def _spent(*arguments: str) -> tuple[float, float]:
    """Run the command; return its processor's seconds and its peak memory, MB."""
    process = subprocess.Popen([sys.executable, "-m", "stillcal", *arguments])
    _, status, used = os.wait4(process.pid, 0)
    if os.waitstatus_to_exitcode(status) != 0:
        raise RuntimeError(f"stillcal {' '.join(arguments)} failed")
    return used.ru_utime + used.ru_stime, used.ru_maxrss / 1024.0
