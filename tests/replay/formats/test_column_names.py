"""Tables whose columns have the names that other people's tools give them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from stillcal.replay.formats.errors import TraceError
from stillcal.replay.formats.recognition.names.stamps import find_stamps, find_thermometer
from stillcal.replay.formats.trace import Recording, read_all
from tests.support.log_files import DATA, rows, text

DEGREES = 180 / np.pi
FORCE, RATE = DATA[:, 1:4], DATA[:, 4:]


def read(folder: Path, header: str, *columns: np.ndarray) -> Recording:
    path = folder / "log.csv"
    path.write_text(text(header, np.column_stack(columns)))
    return read_all(path)


def assert_read(recording: Recording) -> None:
    assert recording.gyroscope is not None
    np.testing.assert_allclose(recording.accelerometer.xyz, FORCE, rtol=1e-9)
    np.testing.assert_allclose(recording.gyroscope.xyz, RATE, rtol=1e-9)
    t = recording.accelerometer.t
    np.testing.assert_allclose(t - t[0], DATA[:, 0], atol=1e-6)


@pytest.mark.parametrize(
    ("rates", "per_rad"),
    [
        ("roll_rate,pitch_rate,yaw_rate", 1.0),
        ("rollRate (deg/s),pitchRate (deg/s),yawRate (deg/s)", DEGREES),
        ("rollspeed,pitchspeed,yawspeed", 1.0),
        ("gyro_roll,gyro_pitch,gyro_yaw", DEGREES),
        ("p,q,r", 1.0),
        ("p_dps,q_dps,r_dps", DEGREES),
        ("gyro_x [mrad/s],gyro_y [mrad/s],gyro_z [mrad/s]", 1000.0),
        ("Gyro X (deg/sec),Gyro Y (deg/sec),Gyro Z (deg/sec)", DEGREES),
        ("Gyro-X (d/s),Gyro-Y (d/s),Gyro-Z (d/s)", DEGREES),
        ("GyX,GyY,GyZ", DEGREES),
    ],
)
@pytest.mark.parametrize("force", ["ax,ay,az", "acc_x,acc_y,acc_z"])
def test_rates_of_other_names_are_the_gyroscope(
    tmp_path: Path, force: str, rates: str, per_rad: float
) -> None:
    assert_read(read(tmp_path, f"t,{force},{rates}", DATA[:, 0], FORCE, RATE * per_rad))


@pytest.mark.parametrize("form", ["imu[{}].acc_{}", "acc[{}].{}", "data.accel[{}].value{}"])
def test_sensors_that_are_numbered_in_brackets_are_several(tmp_path: Path, form: str) -> None:
    axes = "012" if form.endswith("value{}") else "xyz"
    header = ",".join(["t", *(form.format(number, axis) for number in (0, 1) for axis in axes)])
    recording = read(tmp_path, header, DATA[:, 0], FORCE, 1.01 * FORCE)
    np.testing.assert_allclose(recording.accelerometer.xyz, FORCE, rtol=1e-9)
    assert "has 2 sensors" in recording.notes[0]


def test_a_sketchs_short_names_are_both_sensors_and_the_thermometer(tmp_path: Path) -> None:
    header = "millis,AcX,AcY,AcZ,Tmp,GyX,GyY,GyZ"
    warm = np.full(len(DATA), 25.0)
    recording = read(tmp_path, header, 1e3 * DATA[:, 0], FORCE, warm, RATE)
    assert_read(recording)
    np.testing.assert_allclose(recording.accelerometer.temperature, 25.0)


@pytest.mark.parametrize(
    "axes",
    ["x-axis,y-axis,z-axis", "X Axis,Y Axis,Z Axis", "axis_x,axis_y,axis_z", "X_value,Y_value,Z_value"],
)
def test_axes_that_nothing_names_may_be_called_axes_or_values(tmp_path: Path, axes: str) -> None:
    recording = read(tmp_path, f"timestamp,{axes}", 1e3 * DATA[:, 0], FORCE)
    np.testing.assert_allclose(recording.accelerometer.xyz, FORCE, rtol=1e-9)
    with pytest.raises(TraceError, match="no accelerometer found"):
        read(tmp_path, f"timestamp,{axes}", 1e3 * DATA[:, 0], 3 * FORCE)


@pytest.mark.parametrize("angles", ["roll,pitch,yaw", "p,q,s", "roll_rate_sp,pitch_rate_sp,yaw_rate_sp"])
def test_angles_and_wanted_rates_are_no_gyroscope(tmp_path: Path, angles: str) -> None:
    assert read(tmp_path, f"t,ax,ay,az,{angles}", DATA[:, 0], FORCE, RATE).gyroscope is None


@pytest.mark.parametrize("frame", ["earth", "world", "global"])
def test_acceleration_in_axes_of_the_earth_is_no_sensors(tmp_path: Path, frame: str) -> None:
    turned = ",".join(f"acc_{frame}_{axis}" for axis in "xyz")
    level = np.tile([0.0, 0.0, 9.81], (len(DATA), 1))
    header = f"time,{turned},acc_x,acc_y,acc_z,gyr_x,gyr_y,gyr_z"
    assert_read(read(tmp_path, header, DATA[:, 0], level, FORCE, RATE))
    with pytest.raises(TraceError, match="no accelerometer found by its names"):
        read(tmp_path, f"time,{turned}", DATA[:, 0], level)


@pytest.mark.parametrize(
    "form", ["{s}{axis}{n}", "{s}{n}{axis}", "{word}{n}_{axis}", "{word}_{axis}_{n}", "{word}{n}{axis}"]
)
def test_sensors_that_are_numbered_are_several(tmp_path: Path, form: str) -> None:
    kinds = {"acc": "a", "gyro": "g"}
    header = ["time"] + [
        form.format(s=s, word=word, n=n, axis=axis)
        for n in (1, 2)
        for word, s in kinds.items()
        for axis in "xyz"
    ]
    recording = read(tmp_path, ",".join(header), DATA[:, 0], FORCE, RATE, 1.01 * FORCE, 0.5 * RATE)
    assert_read(recording)
    assert "has 2 sensors: 1 (accelerometer, gyroscope), 2" in recording.notes[0]


@pytest.mark.parametrize("form", ["acc_{},gyr_{}", "acc{},gyro{}", "Acceleration_{},AngularVelocity_{}"])
@pytest.mark.parametrize("first", [0, 1])
def test_the_columns_of_a_vector_may_be_numbered(tmp_path: Path, form: str, first: int) -> None:
    acc, gyr = form.split(",")
    header = ["time", *(name.format(first + i) for name in (acc, gyr) for i in range(3))]
    assert_read(read(tmp_path, ",".join(header), DATA[:, 0], FORCE, RATE))
    with pytest.raises(TraceError, match="no accelerometer"):  # four sensors of one axis each
        read(tmp_path, ",".join([*header, acc.format(first + 3)]), DATA[:, 0], FORCE, RATE, FORCE[:, 2])


def test_a_letter_beside_a_sensors_word_is_no_sensor(tmp_path: Path) -> None:
    header = "time,imu_a_acc_x,imu_a_acc_y,imu_a_acc_z,imu_a_gyro_x,imu_a_gyro_y,imu_a_gyro_z"
    assert_read(read(tmp_path, header, DATA[:, 0], FORCE, RATE))


def test_columns_in_units_go_before_raw_counts(tmp_path: Path) -> None:
    kinds = [
        f"{sensor}_{axis}_{kind}" for sensor in ("acc", "gyr") for kind in ("raw", "cal") for axis in "xyz"
    ]
    counts = np.round(FORCE / 9.80665 * 4096 + 300)  # which have an offset
    columns = (DATA[:, 0], counts, FORCE, np.round(RATE * 3000), RATE)
    recording = read(tmp_path, ",".join(["time", *kinds]), *columns)
    assert_read(recording)
    assert "has 2 sensors" in recording.notes[0]


def test_a_gyroscope_goes_before_body_rates(tmp_path: Path) -> None:
    header = "time,p,q,r,acc_x,acc_y,acc_z,gyro_x,gyro_y,gyro_z"
    assert_read(read(tmp_path, header, DATA[:, 0], RATE * 0.9, FORCE, RATE))


@pytest.mark.parametrize(
    ("header", "per_second"),
    [
        ("sec,nsec", 1e9),
        ("secs,nsecs", 1e9),
        ("stamp_sec,stamp_nanosec", 1e9),
        ("header.stamp.secs,header.stamp.nsecs", 1e9),
        ("seconds,usec", 1e6),
        ("sec,ms", 1e3),
    ],
)
def test_seconds_and_their_fraction_in_two_columns_are_one_time(
    tmp_path: Path, header: str, per_second: float
) -> None:
    whole, part = np.divmod(np.round((1000 + DATA[:, 0]) * per_second), per_second)
    assert_read(read(tmp_path, f"{header},ax,ay,az,gx,gy,gz", whole, part, FORCE, RATE))


def test_a_messages_own_stamp_goes_before_the_time_of_recording(tmp_path: Path) -> None:
    whole, part = np.divmod(np.round((1000 + DATA[:, 0]) * 1e9), 1e9)
    late = 1000 + DATA[:, 0] + np.random.default_rng(0).uniform(0.001, 0.005, len(DATA))
    header = "Time,header.stamp.secs,header.stamp.nsecs,ax,ay,az,gx,gy,gz"
    assert_read(read(tmp_path, header, late, whole, part, FORCE, RATE))


def test_seconds_beside_whole_milliseconds_are_two_clocks(tmp_path: Path) -> None:
    t = DATA[:, 0]
    assert_read(read(tmp_path, "time_s,time_ms,ax,ay,az,gx,gy,gz", t, np.round(t * 1000), FORCE, RATE))


@pytest.mark.parametrize(("unit", "per_si"), [("cm/s^2", 100.0), ("ug", 1e6 / 9.80665), ("m/s/s", 1.0)])
def test_a_unit_in_brackets_is_believed(tmp_path: Path, unit: str, per_si: float) -> None:
    header = f"t,ax [{unit}],ay [{unit}],az [{unit}],gx,gy,gz"
    assert_read(read(tmp_path, header, DATA[:, 0], FORCE * per_si, RATE))


@pytest.mark.parametrize(
    ("axes", "unit", "per_si"),
    [
        ("a{} (dm/s^2)", r"dm/s\^2", 10.0),
        ("acc_{} (LSB)", "lsb", 1024 / 9.80665),  # about the size of gravity in mg
        ("acc_{}_counts", "counts", 1024 / 9.80665),
    ],
)
def test_a_unit_that_is_not_known_is_not_guessed(tmp_path: Path, axes: str, unit: str, per_si: float) -> None:
    header = ",".join(["t", *map(axes.format, "xyz")])
    with pytest.raises(TraceError, match=rf"in {unit}, which is no unit that is known; .*counts_per_unit"):
        read(tmp_path, header, DATA[:, 0], FORCE * per_si)


@pytest.mark.parametrize(("unit", "per_si"), [("mrad/s", 1e3), ("mdeg/s", 1e3 * DEGREES)])
@pytest.mark.parametrize("slower", [1, 4])
def test_thousandths_of_rates_are_found_as_gravity_turns(
    tmp_path: Path, unit: str, per_si: float, slower: int
) -> None:
    turning = rows(6000 // slower * slower, 100.0 * slower) if slower > 1 else DATA
    t = turning[:, 0] * slower
    header = "usec,xacc,yacc,zacc,xgyro,ygyro,zgyro"
    rates = turning[:, 4:] / slower
    recording = read(tmp_path, header, t * 1e6, turning[:, 1:4], rates * per_si)
    assert recording.gyroscope is not None
    np.testing.assert_allclose(recording.gyroscope.xyz, rates, rtol=1e-9)
    assert f"in {unit}" in recording.notes[0]


def test_turns_a_minute_are_not_taken_for_degrees(tmp_path: Path) -> None:
    header = "t,acc_x,acc_y,acc_z,gyr_x [rpm],gyr_y [rpm],gyr_z [rpm]"
    with pytest.raises(TraceError, match=r"gyr_z \[rpm\] are in rpm, which is no unit that is known"):
        read(tmp_path, header, DATA[:, 0], FORCE, RATE * 30 / np.pi)


def test_whole_numbers_in_the_size_of_mg_may_be_counts(tmp_path: Path) -> None:
    doubt = "whole numbers: if they are raw counts"
    notes = read(tmp_path, "t,accX,accY,accZ", DATA[:, 0], np.round(FORCE / 9.81 * 1024)).notes
    assert any(doubt in note for note in notes)
    notes = read(tmp_path, "t,accX,accY,accZ", DATA[:, 0], FORCE / 9.80665e-3).notes
    assert not any(doubt in note for note in notes)


def test_a_temperature_of_another_name_beside_own_columns_is_read(tmp_path: Path) -> None:
    recording = read(tmp_path, "t,ax,ay,az,gx,gy,gz,temp_K", DATA, np.full(len(DATA), 300.0))
    assert recording.accelerometer.temperature is not None
    np.testing.assert_allclose(recording.accelerometer.temperature, 26.85)


@pytest.mark.parametrize(
    "header",
    [
        "Zeit,Beschleunigung X,Beschleunigung Y,Beschleunigung Z,Drehrate X,Drehrate Y,Drehrate Z",
        "tiempo,aceleración_x,aceleración_y,aceleración_z,giroscopio_x,giroscopio_y,giroscopio_z",
        "tempo,accelerometro_x,accelerometro_y,accelerometro_z,"
        "velocità angolare x,velocità angolare y,velocità angolare z",
        "Tempo (s),Acelerômetro X,Acelerômetro Y,Acelerômetro Z,Giroscópio X,Giroscópio Y,Giroscópio Z",
        "tijdstempel,versnelling x,versnelling y,versnelling z,hoeksnelheid x,hoeksnelheid y,hoeksnelheid z",
        "Znacznik czasu,Przyśpieszenie X,Przyśpieszenie Y,Przyśpieszenie Z,"
        "Prędkość kątowa X,Prędkość kątowa Y,Prędkość kątowa Z",
        "Temps (s),Accélération x,Accélération y,Accélération z,Gyroscope x,Gyroscope y,Gyroscope z",
    ],
)
def test_names_in_other_languages(tmp_path: Path, header: str) -> None:
    recording = read(tmp_path, header, DATA)
    assert_read(recording)
    assert recording.accelerometer.temperature is None


@pytest.mark.parametrize("word", ["Temperatur", "Température", "temperatura", "Temperatuur"])
def test_a_temperature_in_other_languages(tmp_path: Path, word: str) -> None:
    recording = read(tmp_path, f"Temps (s),ax,ay,az,gx,gy,gz,{word}", DATA, np.full(len(DATA), 21.5))
    assert_read(recording)
    assert recording.accelerometer.temperature is not None
    np.testing.assert_array_equal(recording.accelerometer.temperature, 21.5)


def test_a_format_of_two_files_may_hold_both_sensors_in_one(tmp_path: Path) -> None:
    force = ",".join(f'"Acceleration {axis} (m/s^2)"' for axis in "xyz")
    rates = ",".join(f'"Gyroscope {axis} (rad/s)"' for axis in "xyz")
    assert_read(read(tmp_path, f'"Time (s)",{force},{rates}', DATA))


def test_rates_whose_axes_are_not_known_are_named(tmp_path: Path) -> None:
    """Browsers have called x, y, z alpha, beta, gamma, and z, x, y too (W3C, Device Orientation)."""
    recording = read(
        tmp_path, "t_s,acc_x,acc_y,acc_z,rotationRate.alpha,rotationRate.beta,rotationRate.gamma", DATA
    )
    assert recording.gyroscope is None
    assert "not read, since they name no axes x, y, z: rotationRate.alpha" in recording.notes[0]


def test_a_temperature_that_is_called_t_is_not_the_time() -> None:
    for name, unit in (("T [°C]", "degC"), ("T (K)", "K"), ("T_degC", "degC"), ("T [°F]", "degF")):
        names = ["time", "ax", "ay", "az", name]
        assert find_thermometer(names, "") == (name, unit)
        assert [stamps.column for stamps in find_stamps(names)] == ["time"]


@pytest.mark.parametrize(
    ("name", "unit"),
    [("temp [°F]", "degF"), ("Temp (deg F)", "degF"), ("temp °F", "degF"), ("temp [°K]", "K")],
)
def test_degrees_of_a_temperature_may_be_others_than_celsius(name: str, unit: str) -> None:
    """°F was taken as °C, and a slope by temperature was 1.8 times too small."""
    assert find_thermometer([name], "") == (name, unit)
