"""From when a warm-up is counted where a calibration is applied to a recording, or to a part of one."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from stillcal.api import Calibration, apply, load
from stillcal.calib_core.calibration.corrections.term import Term, TermParameter
from stillcal.calib_core.calibration.record import CalibrationRecord
from stillcal.calib_core.streams.samples import Sensor
from stillcal.daemon.store.store import Store
from stillcal.replay.commands.replay import apply_command

BEGAN, TAU_S, RATE_HZ, SECONDS = 1000.0, 8.0, 20.0, 30.0
AMPLITUDE = np.array([0.3, -0.2, 0.1])
TRUE = np.array([0.5, 1.0, 9.7])


@pytest.fixture
def warming(make_record: Any) -> CalibrationRecord:
    parameters = {
        "amplitude": TermParameter(value=AMPLITUDE, unit="m/s^2"),
        "tau_s": TermParameter(value=np.array(TAU_S), unit="s"),
    }
    term = Term(effect="accel_warmup", sensor=Sensor.ACCELEROMETER, parameters=parameters)
    return replace(make_record(4), terms=(term,))


@pytest.fixture
def log(tmp_path: Path, warming: CalibrationRecord) -> Path:
    """A phone at rest that was switched on with its first sample."""
    age = np.arange(SECONDS * RATE_HZ) / RATE_HZ
    part = warming.accelerometer
    raw = np.linalg.inv(part.scale) @ TRUE + part.bias - np.exp(-age / TAU_S)[:, None] * AMPLITUDE
    rows = "".join(f"{BEGAN + t},{x},{y},{z}\n" for t, (x, y, z) in zip(age, raw, strict=True))
    (tmp_path / "log.csv").write_text(f"t,ax,ay,az\n{rows}")
    Store(tmp_path / "store.json").publish(warming)
    return tmp_path / "log.csv"


def applied(log: Path, *options: str) -> tuple[np.ndarray, str]:
    store, out = log.with_name("store.json"), log.with_name("true.csv")
    words = [log, "--store", store, "--out", out, "--quiet", *options]
    ran = CliRunner().invoke(apply_command, list(map(str, words)))
    assert ran.exit_code == 0, ran.output
    return load(out).accelerometer.xyz, ran.output


@pytest.mark.parametrize("part", [(), ("--from", "5"), ("--from", "5", "--to", "12")])
def test_a_warm_up_counts_from_the_beginning_of_the_recording_not_of_the_part(log: Path, part: tuple) -> None:
    force, said = applied(log, *part)
    assert np.abs(force - TRUE).max() < 1e-6
    assert said.count("accel_warmup: corrected as if the phone was switched on when the recording began") == 1


def test_python_counts_as_the_command_does(log: Path, warming: CalibrationRecord) -> None:
    whole = load(log)
    for recording in (
        whole,
        load(log, start=5.0),
        load(whole, start=5.0),
        load(load(whole, start=3.0), start=2.0),
    ):
        true = apply(recording, Calibration(warming))
        assert np.abs(true.accelerometer.xyz - TRUE).max() < 1e-9
        assert sum("switched on when the recording began" in note for note in true.notes) == 1


def test_a_phone_that_was_on_before_is_corrected_from_then_and_nothing_is_assumed(
    log: Path, warming: CalibrationRecord
) -> None:
    late, told = load(log, start=5.0).save(log.with_name("late.csv")), ("--on-for", "5")
    assert late is None and np.abs(applied(log.with_name("late.csv"))[0] - TRUE).max() > 0.1
    force, said = applied(log.with_name("late.csv"), *told)
    assert np.abs(force - TRUE).max() < 1e-6 and not said
    true = apply(log.with_name("late.csv"), Calibration(warming), on_for=5.0)
    assert np.abs(true.accelerometer.xyz - TRUE).max() < 1e-6 and not true.notes


@pytest.mark.parametrize("on_for", [-1.0, float("nan"), float("inf")])
def test_python_refuses_a_time_that_no_phone_can_have_been_on_for(on_for: float, log: Path) -> None:
    with pytest.raises(ValueError, match="on_for is"):
        apply(log, log.with_name("store.json"), on_for=on_for)
