"""One length in a process of its own: `python benchmarks/length.py SECONDS WATCH` prints figures as JSON.

The day's samples are repeated for longer, and read from a file block by block, as a recording would be.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path

import numpy as np
from subject import LOCAL_G, RATE_HZ, flat_file

from stillcal.calib_core.engine.engine import Engine
from stillcal.calib_core.engine.settings import EngineSettings, ScheduleSettings
from stillcal.calib_core.streams.events import End
from stillcal.calib_core.streams.samples import Samples, Sensor

_DAY_S = 86400.0
_BLOCK = 1 << 15


def main(seconds: int, watch: str) -> None:
    """Feed the engine so much and say what it took."""
    file = flat_file()
    in_a_day = file.stat().st_size // 32
    settings = ScheduleSettings(gravity=LOCAL_G, watch=watch)  # type: ignore[arg-type]
    engine = Engine(EngineSettings(schedule=settings))
    wanted, fed, taken = int(seconds * RATE_HZ), 0, 0.0
    while fed < wanted:
        days, first = divmod(fed, in_a_day)
        count = min(_BLOCK, wanted - fed, in_a_day - first)
        rows = np.fromfile(file, count=4 * count, offset=32 * first).reshape(-1, 4)
        t, xyz = rows[:, 0] + days * _DAY_S, np.ascontiguousarray(rows[:, 1:])
        began = time.process_time()
        engine.feed(Samples(Sensor.ACCELEROMETER, t, xyz))
        taken += time.process_time() - began
        fed += count
    began = time.process_time()
    engine.feed(End(seconds + 1.0))
    taken += time.process_time() - began
    peak = int(Path("/proc/self/status").read_text().split("VmHWM:")[1].split()[0]) / 1024
    print(json.dumps({"samples": fed, "seconds": taken, "peak_mb": peak}))


if __name__ == "__main__":
    main(int(sys.argv[1]), sys.argv[2])
