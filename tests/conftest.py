"""Fixtures that all tests share: real recordings, calibrations by number, ten minutes of a phone."""

from __future__ import annotations

import os
import signal
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the commands do; before numpy is first imported
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)  # or each process that is started compiles stillcal anew

import hypothesis
import numpy as np
import pytest

from stillcal.calib_core.accelerometer.parameters import BIAS
from stillcal.calib_core.calibration.record import (
    AccelerometerRecord,
    Acceptance,
    CalibrationRecord,
    GyroscopeRecord,
    How,
    Provenance,
    StateRecord,
    Validity,
)
from stillcal.calib_core.gravity import Gravity
from stillcal.replay.phone import load_phone, load_scenario, simulate

hypothesis.settings.register_profile("busy machine", deadline=None)  # no test asserts how long it took
hypothesis.settings.load_profile("busy machine")

# A shell's job in the background ignores the one, under nohup(1) the other, and so would all that it starts.
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_DFL)


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """The folder of real recordings, from STILLCAL_DATA or beside the checkout; skips where absent."""
    default = Path(__file__).resolve().parents[2] / "shared" / "data"
    folder = Path(os.environ.get("STILLCAL_DATA", default))
    if not folder.is_dir():
        pytest.skip(f"real recordings not found at {folder}: set STILLCAL_DATA to their folder")
    return folder


MakeRecord = Callable[..., CalibrationRecord]


def _record(number: float, how: How = "calibration", states: int = 2) -> CalibrationRecord:
    """Return a calibration whose x bias is `number` hundredths of a m/s^2."""
    state = StateRecord(
        t_start=0.0,
        t_end=9.5,
        n=950,
        specific_force=np.array([0.1, -0.2, 9.81234567890123]),
        force_uncertainty=np.full(3, 1e-3),
        temperature=31.5,
    )
    accelerometer = AccelerometerRecord(
        scale=np.array([[1.01, 0.002, 0.0], [0.002, 0.99, 0.0], [0.0, 0.0, 1.003]]),
        bias=np.array([0.01 * number, -0.2, 0.3]),
        parameters=9,
        names=BIAS,
        covariance=np.array([[1e-6, 0.0, 0.0], [0.0, np.nan, 0.0], [0.0, 0.0, np.inf]]),
        rms_residual=0.0011,
        n_rests=12,
        n_states=9,
        gravity=9.8123,
    )
    gyroscope = GyroscopeRecord(
        scale=np.eye(3), bias=np.array([1e-3, -2e-3, 1 / 3]), parameters=3, zeroed_at=float(number)
    )
    return CalibrationRecord(
        accelerometer=accelerometer,
        gyroscope=gyroscope,
        gravity=Gravity(),
        fitted_at=float(number),
        validity=Validity(temperature_min=20.0, temperature_max=35.0),
        acceptance=Acceptance(how=how, reason=f"number {number}", evidence={"gain": 1.5, "rests": 7}),
        provenance=Provenance(software="stillcal 0.1.0", source="test", t_start=0.0, t_end=99.0),
        states=(state,) * states,
    )


@pytest.fixture(scope="session")
def make_record() -> MakeRecord:
    """Make a calibration by number."""
    return _record


@pytest.fixture(scope="session")
def lab() -> list[Any]:
    """Ten minutes of a phone laid in 24 attitudes."""
    return list(simulate(load_scenario("lab"), load_phone("consumer"), 1).chunks())


@pytest.fixture
def folder() -> Iterator[Path]:
    """A short path that others may enter: socket paths are 107 bytes at most."""
    with tempfile.TemporaryDirectory() as name:
        Path(name).chmod(0o755)
        yield Path(name)
