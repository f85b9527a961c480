"""Rest tables as laboratories write them: other names, units in the header, separators, comments."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from stillcal.calib_core.arrays import Array
from stillcal.replay.formats.errors import TraceError
from stillcal.replay.formats.rest_table import open_rest_table, read_rest_table

G = 9.80665
UP = np.array([[0.0, 0.0, 1.0], [0.0, 0.6, -0.8], [1.0, 0.0, 0.0]])
RATE = np.array([0.01, -0.02, 0.004])
CELSIUS = np.array([21.5, 22.0, 23.5])
MINUTES = np.array([0.0, 1.5, 4.0])


def lines(*columns: Array, sep: str = ",") -> list[str]:
    """Return rows of six decimals, with decimal commas where a semicolon separates."""
    cells = np.column_stack(columns)
    return [sep.join(f"{x:.6f}".replace(".", "," if sep == ";" else ".") for x in row) for row in cells]


def read(path: Path, *text: str) -> tuple[Array, Array, Array]:
    """Return forces and rates (n, 3) and temperatures (n,) of a table."""
    path.write_text("\n".join(text) + "\n")
    rests = read_rest_table(path)
    return (
        np.array([rest.specific_force for rest in rests]),
        np.array([np.full(3, np.nan) if rest.rate is None else rest.rate for rest in rests]),
        np.array([rest.temperature for rest in rests], dtype=float),
    )


RATES = np.tile(RATE, (3, 1))
TABLES = {
    "units in names": [
        "t [min],ax [m/s^2],ay [m/s^2],az [m/s^2],gx [deg/s],gy [deg/s],gz [deg/s],T [°C]",
        *lines(MINUTES, UP * G, np.degrees(RATES), CELSIUS),
    ],
    "g, deg/s and K": [
        "acc_x_g,acc_y_g,acc_z_g,gyr_x_dps,gyr_y_dps,gyr_z_dps,temperature_K",
        *lines(UP, np.degrees(RATES), CELSIUS + 273.15),
    ],
    "semicolons": [
        "No.;Acc X (mg);Acc Y (mg);Acc Z (mg);Wx (mrad/s);Wy (mrad/s);Wz (mrad/s);Temperatur (°C)",
        *lines(np.arange(3), UP * 1e3, RATES * 1e3, CELSIUS, sep=";"),
    ],
    "a line of units": [
        "# chamber 2",
        "t,ax,ay,az,gx,gy,gz,temperature",
        "min,m/s^2,m/s^2,m/s^2,deg/s,deg/s,deg/s,°C",
        *lines(MINUTES, UP * G, np.degrees(RATES), CELSIUS),
    ],
    "a line of units under the own names": [
        "t,duration,n,ax,ay,az,gx,gy,gz,temperature",
        "min,s,-,m/s^2,m/s^2,m/s^2,deg/s,deg/s,deg/s,K",
        *lines(MINUTES, np.ones(3), np.ones(3), UP * G, np.degrees(RATES), CELSIUS + 273.15),
    ],
    "a line of units in brackets, and another one": [
        "t,ax,ay,az,gx,gy,gz,temperature",
        "clock,B17,B17,B17,C2,C2,C2,room",
        "[min],[m/s²],[m/s²],[m/s²],[°/s],[°/s],[°/s],[°C]",
        *lines(MINUTES, UP * G, np.degrees(RATES), CELSIUS),
    ],
    "blank lines": ["", "", "ax,ay,az,gx,gy,gz,temperature", "", *lines(UP * G, RATES, CELSIUS), ""],
}


@pytest.mark.parametrize("text", TABLES.values(), ids=TABLES.keys())
def test_columns_are_found_by_their_names_and_read_in_their_units(tmp_path: Path, text: list[str]) -> None:
    """Columns of other names were passed over without a word, and units in names were not read."""
    force, rate, celsius = read(tmp_path / "r.csv", *text)
    np.testing.assert_allclose(force, UP * G, atol=2e-5)
    np.testing.assert_allclose(rate, RATES, atol=1e-6)
    np.testing.assert_allclose(celsius, CELSIUS, atol=1e-6)


@pytest.mark.parametrize("unit", [1.0, 1e-3, 1e-9])
def test_times_since_1970_show_their_unit(tmp_path: Path, unit: float) -> None:
    """Milliseconds were taken as seconds: a steady drift then had no name."""
    times = [f"{(1.7e9 + t) / unit:.0f}," for t in MINUTES * 60.0]
    rows = [t + row for t, row in zip(times, lines(UP * G), strict=True)]
    (tmp_path / "r.csv").write_text("\n".join(["timestamp,ax,ay,az", *rows]) + "\n")
    starts = [rest.t_start for rest in read_rest_table(tmp_path / "r.csv")]
    np.testing.assert_allclose(np.array(starts) - 1.7e9, MINUTES * 60.0, atol=1e-3)


def test_what_is_read_by_its_name_and_what_is_not_read_is_said(tmp_path: Path) -> None:
    path = tmp_path / "r.csv"
    names = "Position,time [min],ax_mean,ay_mean,az_mean,ax_std,ay_std,az_std,n,duration [s]"
    rows = lines(np.arange(3), MINUTES, UP * G, np.full((3, 3), 0.02), np.full(3, 400.0), np.full(3, 20.0))
    path.write_text("\n".join([names, *rows]) + "\n")
    table = open_rest_table(path)
    assert [rest.t_start for rest in table.rests] == [0.0, 90.0, 240.0]
    assert {(rest.duration, rest.n, *rest.force_uncertainty) for rest in table.rests} == {
        (20.0, 400, 0.001, 0.001, 0.001)
    }
    by_name, left = table.notes
    assert "ax_std as sax" in by_name and "time [min] as t" in by_name and left.endswith("read: Position")


def test_a_scatter_without_a_unit_has_that_of_its_mean(tmp_path: Path) -> None:
    path = tmp_path / "r.csv"
    names = (
        "ax [g],ay [g],az [g],gx [deg/s],gy [deg/s],gz [deg/s],ax_std,ay_std,az_std,gx_std,gy_std,gz_std,n"
    )
    scatter = np.full((3, 3), 0.02)
    rows = lines(UP, np.full((3, 3), 0.5), scatter, scatter, np.full(3, 400.0))
    path.write_text("\n".join([names, *rows]) + "\n")
    for rest in open_rest_table(path).rests:
        assert rest.force_uncertainty == pytest.approx([0.001 * G] * 3)
        assert rest.rate_uncertainty == pytest.approx([np.radians(0.001)] * 3)


SCATTERED = "ax,ay,az,gx,gy,gz,sax,say,saz,sgx,sgy,sgz,n"


def test_a_standard_deviation_of_zero_leaves_the_rounding_of_the_mean(tmp_path: Path) -> None:
    path = tmp_path / "r.csv"
    scatter = np.array([[0.02] * 3, [0.0] * 3, [0.02] * 3])
    path.write_text("\n".join([SCATTERED, *lines(UP * G, RATES, scatter, scatter, np.full(3, 400.0))]) + "\n")
    rests = open_rest_table(path).rests
    assert rests[0].rate_uncertainty == pytest.approx([0.001] * 3)
    for known in (rests[1].force_uncertainty, rests[1].rate_uncertainty):
        assert np.all(np.asarray(known) > 1e-8)


@pytest.mark.parametrize("column", ["saz", "sgx"])
def test_a_standard_deviation_below_zero_is_refused(tmp_path: Path, column: str) -> None:
    scatter = np.full((3, 6), 0.02)
    scatter[1, ("sax", "say", "saz", "sgx", "sgy", "sgz").index(column)] = -0.02
    rows = lines(UP * G, RATES, scatter, np.full(3, 400.0))
    with pytest.raises(TraceError, match=rf"r.csv:3: column '{column}' holds a standard deviation below 0"):
        read(tmp_path / "r.csv", SCATTERED, *rows)


@pytest.mark.parametrize(
    ("unit", "values", "what"),
    [
        ("", UP * 0.01, "about 0.01 in size .* with gravity"),
        ("", UP, r'seem to be in g; .* as "ax \[g\]"'),
        (" [LSB]", UP * 16384.0, "the unit 'lsb' of ax .* is not known"),
    ],
)
def test_forces_of_another_unit_are_refused(tmp_path: Path, unit: str, values: Array, what: str) -> None:
    with pytest.raises(TraceError, match=what):
        read(tmp_path / "r.csv", f"ax{unit},ay{unit},az{unit}", *lines(values))


def still(bias: float, rows: int = 200) -> tuple[Array, Array]:
    """Return forces in many attitudes and rates, deg/s: a bias, the Earth's rotation at 52 degrees, noise."""
    rng = np.random.default_rng(7)
    up = rng.normal(size=(rows, 3))
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    north = np.cross(up, rng.normal(size=(rows, 3)))
    north /= np.linalg.norm(north, axis=1, keepdims=True)
    earth = np.degrees(7.2921e-5) * (np.sin(0.9) * up + np.cos(0.9) * north)
    return up * G, bias * np.array([0.6, -0.8, 0.1]) + earth + rng.normal(size=(rows, 3)) * 1e-3


@pytest.mark.parametrize(("bias", "what"), [(1.5, "no gyroscope's bias in rad/s"), (0.1, "Earth's rotation")])
def test_rates_in_degrees_are_refused_unless_their_names_say_so(
    tmp_path: Path, bias: float, what: str
) -> None:
    """Taken as rad/s they made a finding without a name of the Earth's rotation."""
    force, rate = still(bias)
    with pytest.raises(TraceError, match=what) as refused:
        read(tmp_path / "r.csv", "ax,ay,az,gx,gy,gz", *lines(force, rate))
    assert '"gx [deg/s]" or "gx [rad/s]"' in str(refused.value)
    _, found, _ = read(tmp_path / "s.csv", "ax,ay,az,gx [deg/s],gy [deg/s],gz [deg/s]", *lines(force, rate))
    np.testing.assert_allclose(found, np.radians(rate), atol=1e-7)
    _, found, _ = read(tmp_path / "s.csv", "ax,ay,az,gx [rad/s],gy [rad/s],gz [rad/s]", *lines(force, rate))
    np.testing.assert_allclose(found, rate, atol=1e-6)


@pytest.mark.parametrize(
    ("matrix", "noise"), [(np.diag([4e-4, 4e-4, 1e-4]) + 1e-4, 1e-3), (np.zeros((3, 3)), 3e-3)]
)
def test_g_sensitivity_and_noise_are_not_the_earth_in_degrees(
    tmp_path: Path, matrix: Array, noise: float
) -> None:
    """A part along gravity that differs between the axes, or is no larger than its error."""
    force, rate = still(0.5)
    noisy = np.radians(rate) + force @ matrix + np.random.default_rng(1).normal(size=rate.shape) * noise
    _, found, _ = read(tmp_path / "r.csv", "ax,ay,az,gx,gy,gz", *lines(force, noisy))
    np.testing.assert_allclose(found, noisy, atol=1e-6)


@pytest.mark.parametrize(("matrix", "said"), [(np.zeros((3, 3)), 0), (np.diag([4e-4, -2e-4, 3e-4]), 1)])
def test_rates_that_may_be_either_are_read_with_a_note(tmp_path: Path, matrix: Array, said: int) -> None:
    """Rates that differ by 0.2 deg/s between rests may be so small, or have another unit."""
    force, rate = still(0.5)
    path = tmp_path / "r.csv"
    path.write_text("\n".join(["ax,ay,az,gx,gy,gz", *lines(force, np.radians(rate) + force @ matrix)]) + "\n")
    notes = open_rest_table(path).notes
    assert len(notes) == said and all("name them gx [deg/s]" in note for note in notes)


def test_comments_between_rows_are_passed_over(tmp_path: Path) -> None:
    """They ended in an error, and so did a row that somebody had crossed out with a #."""
    path, rows = tmp_path / "r.csv", lines(MINUTES, UP * G)
    path.write_text("\n".join(["t,ax,ay,az", rows[0], "# heater on", f"#{rows[1]}", rows[1], rows[2]]) + "\n")
    table = open_rest_table(path)
    np.testing.assert_allclose([rest.specific_force for rest in table.rests], UP * G, atol=1e-5)
    assert table.notes == ["r.csv: lines that begin with # between the rows, passed over: 2"]


@pytest.mark.parametrize(
    ("celsius", "what"),
    [(CELSIUS + 273.15, r":2: 294.6 degC .* \[K\]"), ([21.0, -999.0, 22.0], ":3: -999 degC")],
)
def test_temperatures_that_no_sensor_has_are_refused(tmp_path: Path, celsius: Array, what: str) -> None:
    """A -999 for a reading that is missing hid what followed temperature."""
    with pytest.raises(TraceError, match=what):
        read(tmp_path / "r.csv", "ax,ay,az,temperature", *lines(UP * G, np.array(celsius)))


@pytest.mark.parametrize("cell", ["", "nan", "NA"])
def test_a_rest_may_have_no_temperature(tmp_path: Path, cell: str) -> None:
    """R writes NA, which was refused."""
    rows = lines(UP * G, CELSIUS)
    rows[1] = rows[1].rpartition(",")[0] + f",{cell}"
    *_, celsius = read(tmp_path / "r.csv", "ax,ay,az,temperature", *rows)
    np.testing.assert_array_equal(celsius, [CELSIUS[0], np.nan, CELSIUS[2]])


def test_columns_of_the_own_names_go_before_others(tmp_path: Path) -> None:
    names = "time,acc_x,acc_y,acc_z,t,ax,ay,az"
    force, *_ = read(tmp_path / "r.csv", names, *lines(MINUTES, UP[::-1] * G, MINUTES * 60.0, UP * G))
    np.testing.assert_allclose(force, UP * G, atol=1e-5)
    assert [rest.t_start for rest in read_rest_table(tmp_path / "r.csv")] == [0.0, 90.0, 240.0]


def test_a_scatter_has_a_unit_of_its_own(tmp_path: Path) -> None:
    names = "ax,ay,az,ax_std [mg],ay_std [mg],az_std [mg]"
    (tmp_path / "r.csv").write_text("\n".join([names, *lines(UP * G, np.full((3, 3), 2.0))]) + "\n")
    assert {tuple(rest.force_sd) for rest in read_rest_table(tmp_path / "r.csv")} == {(2e-3 * G,) * 3}


def test_a_temperature_of_the_own_name_goes_before_others(tmp_path: Path) -> None:
    *_, celsius = read(
        tmp_path / "r.csv", "temp_room,ax,ay,az,temperature", *lines(CELSIUS - 5.0, UP * G, CELSIUS)
    )
    np.testing.assert_allclose(celsius, CELSIUS)


def test_a_table_that_is_no_text_is_refused_as_such(tmp_path: Path) -> None:
    """JSON was said to hold a header only, after the remedy for it as a recording had been --format rest."""
    (tmp_path / "r.json").write_text('[{"ax": 0.1, "ay": 0.2, "az": 9.8}, {"ax": 9.8, "ay": 0.2, "az": 0.1}]')
    with pytest.raises(TraceError, match="is JSON, and rest tables are read from text only; write it as CSV"):
        open_rest_table(tmp_path / "r.json")
