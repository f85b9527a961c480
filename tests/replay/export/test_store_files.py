"""`stillcal store export` and `import` as a person uses them."""

from __future__ import annotations

import json
import runpy
import shutil
import subprocess
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


def of_reading(nonlinear: bool, warm: bool) -> tuple[Term, ...]:
    """Terms that follow what an axis reads, of both sensors, and a warm-up."""
    out = []
    for sensor, name, size in ((Sensor.ACCELEROMETER, "accel", 1e-3), (Sensor.GYROSCOPE, "gyro", 1e-2)):
        axes = size * np.array([1.0, -0.8, 1.2])
        bends = {
            "quadratic": TermParameter(value=axes, unit=""),
            "cubic": TermParameter(value=axes / 9, unit=""),
        }
        slope = {"slope": TermParameter(value=0.1 * axes, unit="1/K")}
        reference = {"temperature": 24.0}
        if nonlinear:
            out.append(Term(effect=f"{name}_nonlinearity", sensor=sensor, parameters=bends))
        if warm:
            scaled = f"{name}_scale_temperature"
            out.append(Term(effect=scaled, sensor=sensor, parameters=slope, reference=reference))
    late = {
        "amplitude": TermParameter(value=axes, unit=""),
        "tau_s": TermParameter(value=np.array(60.0), unit="s"),
    }
    return (*out, Term(effect="gyro_warmup", sensor=Sensor.GYROSCOPE, parameters=late))


@pytest.mark.parametrize(("nonlinear", "warm"), [(True, True), (True, False), (False, True)])
def test_code_corrects_what_follows_the_reading_and_names_the_warm_up(
    nonlinear, warm, path, tmp_path, make_record
):
    record = replace(make_record(1), terms=of_reading(nonlinear, warm))
    Store(path).publish(record)
    for tool, file in (("numpy", "fix.py"), ("c", "fix.h")):
        said = run("export", path, "--to", tool, "--out", tmp_path / file).stderr
        assert "cannot hold: " in said and "gyro_warmup" in said
        assert not any(word in said for word in ("nonlinearity", "scale_temperature"))
    assert "accel_nonlinearity" in run("export", path, "--to", "px4", "--out", "-").stderr or not nonlinear
    rng = np.random.default_rng(2)
    t, warmth = np.arange(20) / 50.0, rng.uniform(0.0, 50.0, 20)
    force, rate = rng.normal(0.0, 12.0, (20, 3)), rng.normal(0.0, 4.0, (20, 3))
    accel = Samples.checked(Sensor.ACCELEROMETER, t, force, warmth)
    wanted = correct_both(record, accel, Samples.checked(Sensor.GYROSCOPE, t, rate, warmth))
    made = runpy.run_path(str(tmp_path / "fix.py"))["correct"](t, warmth, force, rate)
    np.testing.assert_allclose(made, [wanted[0].xyz, wanted[1].xyz], rtol=0.0, atol=1e-11)
    rows = np.column_stack([warmth, force, rate])
    lines = "".join("{" + ", ".join(map(repr, row)) + "},\n" for row in rows.tolist())
    (tmp_path / "main.c").write_text(
        '#include <stdio.h>\n#include "fix.h"\n'
        f"double rows[20][7] = {{\n{lines}}};\nint main(void) {{\n"
        "  for (int n = 0; n < 20; n++) {\n    stillcal_correct(rows[n][0], rows[n] + 1, rows[n] + 4);\n"
        '    for (int i = 1; i < 7; i++) printf("%.17g ", rows[n][i]);\n  }\n  return 0;\n}\n'
    )
    if shutil.which("cc") is None:
        return
    compiler = ["cc", "-std=c99", "-Wall", "-Wextra", "-Werror", "-o", "main", "main.c", "-lm"]
    subprocess.run(compiler, cwd=tmp_path, check=True)
    out = subprocess.run([str(tmp_path / "main")], check=True, capture_output=True, text=True).stdout
    held = np.reshape([float(x) for x in out.split()], (20, 6))
    np.testing.assert_allclose(held, np.hstack([wanted[0].xyz, wanted[1].xyz]), rtol=0.0, atol=1e-11)


def test_an_import_keeps_terms_with_their_bias_and_scale_and_says_which_it_drops(path, tmp_path, make_record):
    record = replace(make_record(1), terms=of_reading(True, True))
    Store(path).publish(record)
    out = tmp_path / "store.npz"
    run("export", path, "--to", "npz", "--out", out)
    said = run("import", path, "--from", "npz", "--in", out).stderr
    assert said.count("the store keeps its own") == 5 and "gyro_warmup: the store keeps its own" in said
    assert {t.effect for t in Store(path).load().current.terms} == {t.effect for t in record.terms}
    values = dict(np.load(out)) | {"gyroscope_bias": record.gyroscope.bias + 1e-3}
    np.savez(out, **values)
    said = run("import", path, "--from", "npz", "--in", out).stderr
    assert "gyro_warmup: the store's own is dropped, as the new bias and scale were fitted without it" in said
    assert {t.effect[:5] for t in Store(path).load().current.terms} == {"accel"}


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
