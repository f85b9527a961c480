"""`stillcal store export` and `import` as a person uses them."""

from __future__ import annotations

import json
import runpy
from dataclasses import replace

import numpy as np
import pytest
import yaml
from click.testing import CliRunner

from stillcal.calib_core.calibration.corrections.term import Term, TermParameter
from stillcal.calib_core.calibration.terms import correct_both
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.daemon.cli.store import store_group
from stillcal.daemon.store.store import Store


@pytest.fixture
def path(tmp_path, make_record):
    place = tmp_path / "store.json"
    Store(place).publish(make_record(1))
    return place


def run(*words):
    return CliRunner().invoke(store_group, [str(word) for word in words], catch_exceptions=True)


def test_export_names_what_the_tool_cannot_hold(path, tmp_path):
    out = tmp_path / "imu.params"
    result = run("export", path, "--to", "px4", "--out", out)
    assert result.exit_code == 0, result.output
    assert "PX4 cannot hold: " in result.stderr
    assert "gyroscope scale" in result.stderr
    assert "# Not held here: gyroscope scale: [" in out.read_text()
    printed = run("export", path, "--to", "px4", "--out", "-")
    assert "stillcal: standard output: PX4 cannot hold: " in printed.stderr


def test_import_makes_the_file_current_and_keeps_what_it_does_not_hold(path, tmp_path, make_record):
    out = tmp_path / "imu.params"
    run("export", path, "--to", "px4", "--out", out)
    text = out.read_text().replace("CAL_ACC0_XOFF\t", "CAL_ACC0_XOFF\t0.5\t9\n1\t1\tX\t")
    out.write_text(text)
    result = run("import", path, "--from", "px4", "--in", out)
    assert result.exit_code == 0, result.output
    document = Store(path).load()
    before, after = make_record(1), document.current
    assert after.accelerometer.bias[0] == 0.5
    np.testing.assert_array_equal(after.gyroscope.scale, before.gyroscope.scale)
    assert document.history[-1].calibration.id == before.id
    assert "gyroscope scale: the store keeps its own" in result.stderr


def test_import_into_a_store_that_does_not_exist_says_what_it_took(tmp_path, path):
    out, fresh = tmp_path / "imu.yaml", tmp_path / "fresh.json"
    run("export", path, "--to", "kalibr", "--out", out)
    result = run("import", fresh, "--from", "kalibr", "--in", out)
    assert result.exit_code == 0, result.output
    assert "accelerometer bias: zero is taken" in result.stderr
    assert json.loads(run("show", fresh, "--json").output)["accelerometer"]["bias"] == [0.0, 0.0, 0.0]


def test_what_cannot_be_had_is_refused_and_nothing_is_written(path, tmp_path):
    for words in (
        ("export", tmp_path / "none.json", "--to", "px4", "--out", tmp_path / "out"),
        ("export", path, "--to", "px4", "--out", path),
        ("export", path, "--to", "kalibr", "--phone", "nobody", "--out", tmp_path / "out"),
        ("import", tmp_path / "out", "--from", "px4", "--in", path),
    ):
        result = run(*words)
        assert result.exit_code != 0
        assert not (tmp_path / "out").exists()


def test_kalibr_has_the_noise_of_the_phone_where_kalibr_reads_it(path, tmp_path):
    out = tmp_path / "imu.yaml"
    assert run("export", path, "--to", "kalibr", "--phone", "consumer", "--out", out).exit_code == 0
    document = yaml.safe_load(out.read_text())
    # 100 ug/sqrt(Hz), one-sided (consumer.toml); kalibr's sigma sqrt(rate) is the two-sided one.
    assert document["accelerometer_noise_density"] == pytest.approx(100e-6 * 9.80665 / np.sqrt(2.0), rel=1e-6)
    assert document["imu0"]["gyroscope_random_walk"] == document["gyroscope_random_walk"] > 0.0


def test_the_python_module_corrects_as_the_store_does(path, tmp_path, make_record):
    record = make_record(1)
    slope = TermParameter(value=np.array([1e-4, -2e-4, 3e-4]), unit="rad/s/K")
    matrix = TermParameter(value=np.arange(9.0).reshape(3, 3) * 1e-5, unit="(rad/s)/(m/s^2)")
    gyro = Sensor.GYROSCOPE
    terms = (
        Term(
            effect="gyro_bias_temperature",
            sensor=gyro,
            parameters={"slope": slope},
            reference={"temperature": 24.0},
        ),
        Term(effect="gyro_g_sensitivity", sensor=gyro, parameters={"matrix": matrix}),
    )
    record = replace(record, terms=terms)
    Store(path).publish(record)
    out = tmp_path / "fix.py"
    assert run("export", path, "--to", "numpy", "--out", out).exit_code == 0
    rng = np.random.default_rng(2)
    t, warm = np.arange(50) / 50.0, rng.uniform(0.0, 50.0, 50)
    force, rate = rng.normal(0.0, 5.0, (50, 3)), rng.normal(0.0, 1.0, (50, 3))
    accel = Samples.checked(Sensor.ACCELEROMETER, t, force, warm)
    wanted = correct_both(record, accel, Samples.checked(gyro, t, rate, warm))
    made = runpy.run_path(str(out))["correct"](t, warm, force, rate)
    np.testing.assert_allclose(made[0], wanted[0].xyz, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(made[1], wanted[1].xyz, rtol=0.0, atol=1e-12)
