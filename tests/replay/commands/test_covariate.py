"""A further logged column as the driver of a bias, from the file to the answer."""

from __future__ import annotations

import csv
import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.io import savemat

import stillcal
from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.comparison.compare import compare
from stillcal.calib_core.diagnosis.examination import Examination
from stillcal.replay.diagnosis.judged import examined
from stillcal.replay.export.imu import noise_of
from stillcal.replay.formats.covariates import of_values, read_covariates
from stillcal.replay.formats.errors import TraceError
from stillcal.replay.formats.trace import open_trace
from stillcal.replay.phone.phone import load_phone
from tests.support.command_line import ran

RATE_HZ = 20.0

SLOPE = 1.5e-3
"""rad/s per volt."""

VOLTS = 0.25
"""By how much the voltage goes up and down."""


def attitudes(rng: np.random.Generator) -> tuple[Array, Array, Any, Any]:
    """Return times (n,), s, directions (10, 3), which of them holds (n,), and whether it is moved (n,).

    The rates below are no turns from one to the next: too quick for the stamps, they are held against none.
    """
    t = np.arange(int(720 * RATE_HZ)) / RATE_HZ
    ups = rng.normal(size=(10, 3))
    ups /= np.linalg.norm(ups, axis=1, keepdims=True)
    return t, ups, (t / 72.0).astype(int), (t % 72.0) < 4.0


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Twelve minutes at 20 Hz in ten attitudes; the gyroscope's z follows a voltage logged each 36 s."""
    rng = np.random.default_rng(4)
    t, ups, which, moving = attitudes(rng)
    minutes = np.arange(0.0, 721.0, 36.0)
    volts = 3.8 + VOLTS * np.sin(minutes / 114.0) + 0.05 * rng.normal(size=minutes.size)
    force = 9.80665 * ups[which] + rng.normal(size=(t.size, 3)) * np.where(moving, 0.8, 0.01)[:, None]
    rate = rng.normal(size=(t.size, 3)) * np.where(moving, 8.0, 0.001)[:, None]
    rate[:, 2] += SLOPE * (np.interp(t, minutes, volts) - 3.8)
    logged = np.full(t.size, "", dtype=object)
    logged[np.searchsorted(t, minutes[:-1])] = [f"{v:.5f}" for v in volts[:-1]]
    path = tmp_path_factory.mktemp("log") / "log.csv"
    write(path, t, force, rate, {"battery_v": logged})
    return path


def write(path: Path, t: Array, force: Array, rate: Array, logged: dict[str, Any]) -> None:
    """Write a recording with further columns, (n,) each."""
    with path.open("w") as out:
        out.write(",".join(["t,ax,ay,az,gx,gy,gz", *logged]) + "\n")
        for i in range(t.size):
            numbers = [f"{x:.7g}" for x in (t[i], *force[i], *rate[i])]
            out.write(",".join([*numbers, *(str(column[i]) for column in logged.values())]) + "\n")


def run(*words: object) -> tuple[int, str]:
    """Run the command; return exit code and output."""
    done = ran("diagnose", *words)
    return done.returncode, (done.stdout + done.stderr).decode()


def test_a_bias_that_follows_a_logged_column_is_found_with_its_slope(log: Path, tmp_path: Path) -> None:
    answer = tmp_path / "answer.json"
    left = tmp_path / "left.csv"
    better = tmp_path / "better.toml"
    words = ("--json", answer, "--residuals", left, "--phone-out", better)
    code, text = run(log, "--covariate", "battery_v", *words)
    assert code == 0, text
    said = json.loads(answer.read_text())
    assert [f["effect"] for f in said["findings"]] == ["gyro_bias_battery_v"]
    assert said["verdict"] == "identified"
    slope = said["findings"][0]["parameters"]["slope"]
    assert slope["value"][2] == pytest.approx(SLOPE, rel=0.1)
    low, high = slope["ci95"][2]
    assert low < SLOPE < high
    assert slope["unit"] == "rad/s per unit of battery_v"
    assert "change of the gyroscope's bias with the column battery_v" in text
    rows = list(csv.DictReader(left.open()))
    z = np.array([[float(r["ideal"]), float(r["with_effects"])] for r in rows if r["residual"] == "rate_z"])
    before, after = np.sqrt(np.mean(z**2, axis=0))
    assert after < 0.5 * before
    assert {r["unit"] for r in rows} <= {"m/s^2", "rad/s", "rad"}
    # The slow noise is what is left after the effect, in the corrected simulation as in the phone file.
    assert said["fit"]["p_after"] > 0.5
    gyro = load_phone(str(better)).gyro
    assert gyro is not None
    assert noise_of(gyro).slow_deviation().max() < 0.1 * SLOPE * VOLTS


def test_a_pipe_has_its_further_columns_too(log: Path) -> None:
    done = ran("diagnose", "-", "--covariate", "battery_i", given=log.read_bytes())
    assert done.returncode == 2
    assert (
        b"standard input: it has no column 'battery_i'; it has t, ax, ay, az, gx, gy, gz, battery_v"
        in done.stderr
    )


@pytest.mark.slow
def test_python_takes_the_column_as_values_or_with_times_of_its_own(log: Path) -> None:
    (read,) = read_covariates(open_trace(log), ["battery_v"]).values()
    recording = stillcal.load(log)
    answer = stillcal.diagnose(recording, covariates={"battery_v": (read.t, read.values)})
    assert [f["effect"] for f in answer.findings] == ["gyro_bias_battery_v"]
    stamps = np.asarray(recording.accelerometer.t)
    every = np.full(stamps.size, np.nan)
    every[np.searchsorted(stamps, read.t)] = read.values
    alike = of_values("battery_v", every, stamps)
    np.testing.assert_array_equal(alike.t, stamps[np.searchsorted(stamps, read.t)])
    np.testing.assert_array_equal(alike.values, read.values)


@pytest.mark.parametrize(
    ("values", "fault"),
    [
        ([1.0, 2.0], "the covariate has shape (2,) and its times (3,)"),
        (["a", "b", "c"], "holds what is not a number"),
        ([np.nan] * 3, "holds no numbers"),
        (([2.0, 1.0], [0.0, 0.0]), "times run backwards"),
    ],
)
def test_values_that_cannot_be_used_are_refused(values: Any, fault: str) -> None:
    with pytest.raises(TraceError, match=re.escape(fault)) as refused:
        of_values("load", values, np.arange(3.0))
    assert str(refused.value).startswith("load: ")


def test_a_data_frame_of_columns_is_taken_as_a_mapping_is() -> None:
    pandas = pytest.importorskip("pandas")
    with pytest.raises(TraceError, match=r"^load: the covariate has shape \(3,\)"):
        stillcal.diagnose("sample:lab", covariates=pandas.DataFrame({"load": [1.0, 2.0, 3.0]}))
    with pytest.raises(TypeError, match="a mapping, or a data frame"):
        stillcal.diagnose("sample:lab", covariates=["load"])  # type: ignore[arg-type]


def examined_with(path: Path, column: bool = True) -> Examination:
    """Return the examination of a log, with its column or without."""
    recording = open_trace(path).recording(path.name)
    logged = read_covariates(open_trace(path), ["battery_v"]) if column else {}
    return examined(replace(recording, covariates=logged))


@pytest.fixture(scope="module")
def recorded(log: Path) -> Examination:
    return examined_with(log)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("part", "column", "relation"),
    [(0.4, True, "too_small"), (0.0, True, "lacking"), (0.0, False, "lacking")],
)
def test_a_simulation_is_told_how_much_of_the_effect_it_lacks(
    recorded: Examination, tmp_path: Path, part: float, column: bool, relation: str
) -> None:
    """Another course of the voltage, about another mean; and none, where the bias is steady."""
    rng = np.random.default_rng(6)
    t, ups, which, moving = attitudes(rng)
    volts = 4.1 + VOLTS * np.cos(t / 78.0)
    force = 9.80665 * ups[which] + rng.normal(size=(t.size, 3)) * np.where(moving, 0.8, 0.01)[:, None]
    rate = rng.normal(size=(t.size, 3)) * np.where(moving, 8.0, 0.001)[:, None]
    rate[:, 2] += part * SLOPE * (volts - 3.8)
    path = tmp_path / "sim.csv"
    write(path, t, force, rate, {"battery_v": np.round(volts, 5)} if column else {})
    found = compare(recorded, examined_with(path, column), ("log.csv", "sim.csv"))
    (one,) = found.discrepancies
    assert (one.effect, one.relation) == ("gyro_bias_battery_v", relation)
    assert one.difference is not None
    assert one.difference.value[2] == pytest.approx((1.0 - part) * SLOPE, rel=0.15)
    assert ("The battery_v of sim.csv is not known" in one.note) is not column
    assert one.difference.recorded.reference["battery_v"] == pytest.approx(3.8, abs=0.2)


@pytest.mark.slow
def test_a_copy_of_temperature_does_not_take_its_name_away(tmp_path: Path) -> None:
    """The column says the same of the bias as temperature does: an alternative, and no other explanation."""
    rng = np.random.default_rng(20)
    t, ups, which, moving = attitudes(rng)
    warm = 28.0 + 5.0 * np.sin(t / 67.0) + 2.0 * np.sin(t / 32.0)
    force = 9.80665 * ups[which] + rng.normal(size=(t.size, 3)) * np.where(moving, 0.8, 0.01)[:, None]
    rate = rng.normal(size=(t.size, 3)) * np.where(moving, 8.0, 0.001)[:, None]
    rate += np.outer(warm - 28.0, [2e-4, 0.0, -1e-4])
    path, answer = tmp_path / "copy.csv", tmp_path / "answer.json"
    fahrenheit = np.round(1.8 * warm + 32.0, 1)
    write(path, t, force, rate, {"temperature": np.round(warm, 2), "case_f": fahrenheit})
    code, text = run(path, "--covariate", "case_f", "--json", answer)
    assert code == 0, text
    (found,) = json.loads(answer.read_text())["findings"]
    assert found["effect"] == "gyro_bias_temperature"
    alike = [a["effect"] for a in found["alternatives"] if a["indistinguishable"]]
    assert "gyro_bias_case_f" in alike
    why = "the column case_f is a copy of temperature, and cannot be told from it"
    assert f"bias with the column case_f - {why}" in text


def test_a_column_that_does_not_change_is_said_to_drive_nothing(log: Path, tmp_path: Path) -> None:
    path = tmp_path / "short.csv"
    header, *lines = log.read_text().splitlines()[:900]
    path.write_text("\n".join([header, *(line.rpartition(",")[0] + ",3.8" for line in lines)]) + "\n")
    code, text = run(path, "--covariate", "battery_v")
    why = "the column battery_v does not change at rest, so nothing can follow it"
    assert code == 0 and f"the gyroscope's bias with the column battery_v - {why}" in text


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--covariate", "battery"), "it has no column 'battery'; it has t, ax"),
        (("--covariate", "az\x1b"), "it has no column"),
        (("--covariate", "az"), "'az' is a sensor's own column"),
        (("--residuals", "left.txt"), "left.txt: choose a name that ends in .csv"),
    ],
)
def test_a_column_that_is_not_there_is_told_in_one_line(log: Path, words: tuple[str, ...], said: str) -> None:
    code, text = run(log, *words)
    assert code == 2
    assert said in text
    assert len(text.strip().splitlines()) == 1


def test_a_cell_that_is_no_number_names_its_row(tmp_path: Path) -> None:
    path = tmp_path / "bad.csv"
    rows = [f"{i / 50},0,0,9.8,{'high' if i == 600 else i}" for i in range(1000)]
    path.write_text("\n".join(["t,ax,ay,az,load", *rows]) + "\n")
    code, text = run(path, "--covariate", "load")
    assert code == 2
    assert "bad.csv:602: column 'load' holds 'high'" in text and "name a column of numbers" in text


@pytest.mark.parametrize("cell", ["wifi", "nan"])
def test_a_column_without_numbers_names_the_further_ones(tmp_path: Path, cell: str) -> None:
    path = tmp_path / "modes.csv"
    rows = [f"{i / 50},0,0,9.8,{cell},{'nan' if i % 10 else i}" for i in range(1000)]
    path.write_text("\n".join(["t,ax,ay,az,mode,load", *rows]) + "\n")
    code, text = run(path, "--covariate", "mode")
    assert code == 2
    assert ("the column 'mode' holds no numbers" if cell == "nan" else "column 'mode' holds 'wifi'") in text
    assert "name a column of numbers; further ones: load" in text


def test_a_cell_of_nan_is_left_out(tmp_path: Path) -> None:
    path = tmp_path / "sparse.csv"
    path.write_text("t,ax,ay,az,load\n0,0,0,9.8,3\n1,0,0,9.8,nan\n2,0,0,9.8,5\n")
    load = read_covariates(open_trace(path), ["load"])["load"]
    assert load.at(np.array([1.0])) == pytest.approx(4.0)


@pytest.mark.parametrize("ending", ["parquet", "h5", "mat", "npz", "json"])
def test_a_column_is_read_from_every_kind_of_table(tmp_path: Path, ending: str) -> None:
    rng, t = np.random.default_rng(3), np.arange(300) / 50.0
    table = {"t": t, "ax": rng.normal(0, 0.01, 300), "ay": rng.normal(0, 0.01, 300)}
    table |= {"az": 9.81 + rng.normal(0, 0.01, 300), "load": np.where(np.arange(300) % 5, np.nan, t)}
    path = tmp_path / f"log.{ending}"
    if ending == "parquet":
        arrow, parquet = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
        parquet.write_table(arrow.table(table), path)
    elif ending == "h5":
        with pytest.importorskip("h5py").File(path, "w") as file:
            for name, column in table.items():
                file[name] = column
    elif ending == "mat":
        savemat(path, table)
    elif ending == "npz":
        np.savez(path, **table)
    else:
        rows = [dict(zip(table, map(float, row), strict=True)) for row in zip(*table.values(), strict=True)]
        path.write_text(json.dumps([{k: v for k, v in row.items() if v == v} for row in rows]))
    load = read_covariates(open_trace(path), ["load"])["load"]
    np.testing.assert_allclose(load.t, t[::5])
    np.testing.assert_allclose(load.values, t[::5])


def test_a_column_of_texts_is_no_column_of_numbers(tmp_path: Path) -> None:
    arrow, parquet = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    t = np.arange(300) / 50.0
    table = {"t": t, "ax": 0.1 + 0.0 * t, "ay": 0.2 + 0.0 * t, "az": 9.8 + 0.0 * t, "mode": ["a", "b"] * 150}
    parquet.write_table(arrow.table(table), tmp_path / "log.parquet")
    with pytest.raises(TraceError, match="the column 'mode' holds texts"):
        read_covariates(open_trace(tmp_path / "log.parquet"), ["mode"])


def test_a_column_of_the_gyroscopes_own_table_is_read_by_its_time(tmp_path: Path) -> None:
    t, slow = np.arange(300) / 50.0, np.arange(30) / 5.0
    force, rates = tmp_path / "accelerometer.csv", tmp_path / "gyroscope.csv"
    force.write_text("t,ax,ay,az\n" + "".join(f"{x},0.1,0.2,9.8\n" for x in t))
    rates.write_text("t,gx,gy,gz,load\n" + "".join(f"{x},0.01,0.02,0.01,{2 * x}\n" for x in slow))
    load = read_covariates(open_trace(force, gyro=rates), ["load"])["load"]
    np.testing.assert_allclose([load.t, load.values], [slow, 2.0 * slow])


def test_a_column_is_read_over_the_time_of_a_recognised_log(tmp_path: Path) -> None:
    """Stamps in ms under another name, as the samples have them."""
    path = tmp_path / "foreign.csv"
    rows = [f"{20 * i + 5000},0.1,0.2,9.8,{i / 10 if i % 5 == 0 else ''}" for i in range(500)]
    path.write_text("\n".join(["timestamp,ax,ay,az,load", *rows]) + "\n")
    opened = open_trace(path)
    load = read_covariates(opened, ["load"])["load"]
    samples = opened.recording("foreign").accelerometer
    np.testing.assert_allclose(load.t, samples.t[::5])
    np.testing.assert_allclose(load.at(samples.t[50:51]), 5.0)
    code, text = run(path, "--covariate", "load")
    assert "it has no column" not in text and code in (0, 3)


def test_dates_are_read_as_the_samples_dates_are(tmp_path: Path) -> None:
    path = tmp_path / "dated.csv"
    start = np.datetime64("2026-03-01T10:00:00.000")
    stamps = [str(start + np.timedelta64(20 * i, "ms")) for i in range(300)]
    rows = [f"{stamp},0.1,0.2,9.8,{i}" for i, stamp in enumerate(stamps)]
    path.write_text("\n".join(["time,ax,ay,az,load", *rows]) + "\n")
    opened = open_trace(path)
    load = read_covariates(opened, ["load"])["load"]
    np.testing.assert_allclose(load.t, opened.recording("dated").accelerometer.t)
