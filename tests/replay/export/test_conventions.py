"""Each tool's published equation, with the numbers of its file, corrects as the store does.

The equations are written from the tools' own sources (each target's module names them), not from stillcal.
"""

from __future__ import annotations

import json
import subprocess
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scipy.signal import lfilter

from stillcal.replay.export.imu import ImuParameters, SensorNoise, SensorPart
from stillcal.replay.export.target import exported
from stillcal.replay.export.targets import target_named
from tests.replay.export.test_round_trip import random_imu, within

RNG = np.random.default_rng(5)
FORCE, RATE = RNG.normal(0.0, 6.0, 3), RNG.normal(0.0, 1.0, 3)
"""A true specific force, m/s^2, and a true rate, rad/s."""

TEMPERATURE = 31.0


def written(name: str, imu: ImuParameters) -> str:
    return exported(target_named(name), imu, "store.json").data.decode()


def read_by(imu: ImuParameters, at: float = TEMPERATURE) -> tuple[np.ndarray, np.ndarray]:
    """What the sensors read, the store's model turned round: inv(scale) true + bias + matrix force."""
    accel, gyro = imu.accelerometer, imu.gyroscope
    assert accel is not None and gyro is not None
    raw = [
        np.linalg.solve(np.eye(3) if p.scale is None else p.scale, x)
        for p, x in ((accel, FORCE), (gyro, RATE))
    ]
    raw = [r + p.bias_at(at) for r, p in zip(raw, (accel, gyro), strict=True)]
    return raw[0], raw[1] + (0.0 if gyro.matrix is None else gyro.matrix @ FORCE)


def held(name: str) -> ImuParameters:
    return within(random_imu(3), target_named(name))


def test_kalibr_and_openvins() -> None:
    imu = random_imu(3)
    bias = {n: replace(p, slope=None) for n, p in imu.parts()}
    imu = replace(imu, **bias)
    raw = read_by(imu)
    chain = yaml.safe_load(written("kalibr", imu))["imu0"]
    m, (mg, a, c) = (
        chain["accelerometers"]["M"],
        (np.array(chain["gyroscopes"][k]) for k in ("M", "A", "C_gyro_i")),
    )
    assert imu.accelerometer is not None and imu.gyroscope is not None
    np.testing.assert_allclose(m @ FORCE + imu.accelerometer.offset, raw[0], atol=1e-9)
    np.testing.assert_allclose(mg @ c @ RATE + a @ c @ FORCE + imu.gyroscope.offset, raw[1], atol=1e-9)
    ta, ra, tw, rw, tg = (np.array(chain[k]) for k in ("Ta", "R_IMUtoACC", "Tw", "R_IMUtoGYRO", "Tg"))
    force = ra.T @ np.linalg.inv(ta) @ (raw[0] - imu.accelerometer.offset)
    np.testing.assert_allclose(force, FORCE, atol=1e-9)
    rate = rw.T @ np.linalg.inv(tw) @ (raw[1] - imu.gyroscope.offset - tg @ force)
    np.testing.assert_allclose(rate, RATE, atol=1e-9)
    for lower in (ta, tw, mg):
        assert not np.triu(lower, 1).any()


def parameters(text: str, name: int, value: int) -> dict[str, float]:
    rows = [line.replace(",", " ").split() for line in text.splitlines() if not line.startswith("#")]
    return {row[name]: float(row[value]) for row in rows}


BENT_AT = [(False, TEMPERATURE), (True, TEMPERATURE), (True, -20.0), (True, 70.0)]
"""Whether the bias follows a cubic, and a temperature: within its limits, below and above them."""


@pytest.mark.parametrize(("bent", "at"), BENT_AT)
def test_px4(bent: bool, at: float) -> None:
    imu = random_imu(3, bent=bent)
    raw = read_by(within(imu, target_named("px4")), at)
    p = parameters(written("px4", imu), 2, 3)
    for sensor, thermal, reading, truth in (("ACC", "A", raw[0], FORCE), ("GYRO", "G", raw[1], RATE)):
        clipped = min(max(at, p[f"TC_{thermal}0_TMIN"]), p[f"TC_{thermal}0_TMAX"])
        warmer = clipped - p[f"TC_{thermal}0_TREF"]
        for i, axis in enumerate("XYZ"):
            offset = sum(p[f"TC_{thermal}0_X{k}_{i}"] * warmer**k for k in range(4))
            scale = p.get(f"CAL_{sensor}0_{axis}SCALE", 1.0)
            corrected = (reading[i] - offset - p[f"CAL_{sensor}0_{axis}OFF"]) * scale
            assert corrected == pytest.approx(truth[i], abs=1e-9)


@pytest.mark.parametrize(("bent", "at"), BENT_AT)
def test_ardupilot(bent: bool, at: float) -> None:
    imu = random_imu(3, bent=bent)
    raw = read_by(within(imu, target_named("ardupilot")), at)
    p = parameters(written("ardupilot", imu), 0, 1)
    for sensor, thermal, reading, truth in (("ACC", "ACC", raw[0], FORCE), ("GYR", "GYR", raw[1], RATE)):
        for i, axis in enumerate("XYZ"):
            c = [p[f"INS_TCAL1_{thermal}{k}_{axis}"] for k in (1, 2, 3)]

            def polynomial(t: float, c: list[float] = c) -> float:
                d = min(max(t, p["INS_TCAL1_TMIN"]), p["INS_TCAL1_TMAX"]) - 35.0
                return (c[0] + (c[1] + c[2] * d) * d) * d * 1e-6

            value = reading[i] - polynomial(at) + polynomial(p[f"INS_{thermal}1_CALTEMP"])
            value = (value - p[f"INS_{sensor}OFFS_{axis}"]) * p.get(f"INS_{sensor}SCAL_{axis}", 1.0)
            assert value == pytest.approx(truth[i], abs=1e-9)


def test_android() -> None:
    imu = held("android")
    raw = read_by(imu)
    value = json.loads(written("android", random_imu(3)))
    for sensor, reading, truth in (("accelerometer", raw[0], FORCE), ("gyroscope", raw[1], RATE)):
        [frame] = value[sensor]["additional_info"]
        assert frame["type"] == 65538
        np.testing.assert_allclose(
            np.reshape(frame["floatValues"], (3, 4)) @ [*reading, 1.0], truth, atol=1e-9
        )


def test_iio() -> None:
    raw = read_by(held("iio"))
    p = parameters(written("iio", random_imu(3)), 0, 1)
    for channel, reading, truth in (("in_accel", raw[0], FORCE), ("in_anglvel", raw[1], RATE)):
        for i, axis in enumerate("xyz"):
            corrected = (reading[i] + p[f"{channel}_{axis}_calibbias"]) * p[f"{channel}_{axis}_calibscale"]
            assert corrected == pytest.approx(truth[i], abs=1e-9)


def test_imusensor_simulates_what_the_sensor_reads() -> None:
    imu = held("imusensor")
    values: dict[str, np.ndarray] = {}
    for line in written("imusensor", imu).splitlines():
        if line.startswith("imu."):
            key, _, value = line[4:-1].partition(" = ")
            values[key] = np.array([[float(x) for x in r.split()] for r in value.strip("[]").split(";")])
    raw = read_by(imu)
    for sensor, sign, true, reading in (("Accelerometer", -1, FORCE, raw[0]), ("Gyroscope", 1, RATE, raw[1])):
        given = sign * true
        out = values[f"{sensor}.AxesMisalignment"] / 100.0 @ given + values[f"{sensor}.ConstantBias"][0]
        out = out + (TEMPERATURE - 25.0) * values[f"{sensor}.TemperatureBias"][0]
        np.testing.assert_allclose(sign * out, reading, atol=1e-9)


@pytest.mark.parametrize(("bent", "at"), BENT_AT)
def test_c(tmp_path: Path, bent: bool, at: float) -> None:
    imu = random_imu(3, bent=bent)
    raw = read_by(imu, at)
    (tmp_path / "calibration.h").write_text(written("c", imu))
    numbers = [", ".join(map(repr, x.tolist())) for x in raw]
    (tmp_path / "main.c").write_text(
        '#include <stdio.h>\n#include "calibration.h"\nint main(void) {\n'
        f"  double f[3] = {{{numbers[0]}}}, w[3] = {{{numbers[1]}}};\n"
        f"  stillcal_correct({at}, f, w);\n"
        '  for (int i = 0; i < 6; i++) printf("%.17g ", i < 3 ? f[i] : w[i - 3]);\n  return 0;\n}\n'
    )
    compiler = ["cc", "-std=c99", "-Wall", "-Wextra", "-Werror", "-o", "main", "main.c", "-lm"]
    try:
        subprocess.run(compiler, cwd=tmp_path, check=True)
    except FileNotFoundError:
        pytest.skip("there is no C compiler")
    out = subprocess.run([str(tmp_path / "main")], check=True, capture_output=True, text=True).stdout
    np.testing.assert_allclose([float(x) for x in out.split()], [*FORCE, *RATE], atol=1e-12)


@pytest.mark.parametrize(("bent", "at"), BENT_AT)
def test_numpy(bent: bool, at: float) -> None:
    imu = random_imu(3, bent=bent)
    names: dict[str, Any] = {}
    exec(written("numpy", imu), names)
    force, rate = (raw[None] for raw in read_by(imu, at))
    made = names["correct"](np.zeros(1), np.array([at]), force, rate)
    np.testing.assert_allclose([made[0][0], made[1][0]], [FORCE, RATE], atol=1e-12)


NOISE = SensorNoise(white=np.array([2e-3, 3e-3, 4e-3]), rate_hz=200.0, random_walk=np.full(3, 1e-5))


def noisy(noise: SensorNoise = NOISE) -> ImuParameters:
    part = SensorPart(bias=np.array([0.1, -0.2, 0.3]), noise=noise)
    return ImuParameters(accelerometer=part, gyroscope=part, identity="abc")


def test_gazebo_has_a_sample_s_own_deviation_and_the_sign_of_the_bias() -> None:
    root = ET.fromstring(written("gazebo", noisy()))
    [noise] = root.findall(".//linear_acceleration/y/noise")
    assert [child.tag for child in noise] == [
        "mean",
        "stddev",
        "dynamic_bias_stddev",
        "dynamic_bias_correlation_time",
    ]
    assert float(noise.findtext("mean") or "nan") == -0.2
    # One-sided 3e-3 per sqrt(Hz) over a band of 100 Hz.
    assert float(noise.findtext("stddev") or "nan") == pytest.approx(3e-3 * 10.0)
    assert float(noise.findtext("dynamic_bias_stddev") or "nan") == pytest.approx(1e-5)


def test_a_lone_gauss_markov_process_keeps_its_spread_in_gazebo() -> None:
    lone = replace(NOISE, random_walk=np.zeros(3), gauss_markov=((np.full(3, 5e-4), 300.0),))
    root = ET.fromstring(written("gazebo", noisy(lone)))
    [x] = root.findall(".//angular_velocity/x/noise")
    density, tau = (float(x.findtext(f"dynamic_bias_{k}") or "nan") for k in ("stddev", "correlation_time"))
    assert density * np.sqrt(tau / 2.0) == pytest.approx(5e-4)
    assert tau == 300.0


def test_airsim_in_its_own_units() -> None:
    imu = json.loads(written("airsim", noisy()))["Vehicles"]["Drone1"]["Sensors"]["Imu"]
    g, degree = 9.80665, np.pi / 180.0
    rms = np.sqrt((4.0 + 9.0 + 16.0) / 3.0) * 1e-3
    # ImuSimple.hpp: a sample's deviation is the density over sqrt(dt); at 200 Hz that is rms sqrt(200 / 2).
    vrw, arw = imu["VelocityRandomWalk"] * g / 1e3, imu["AngularRandomWalk"] / 60.0 * degree
    assert [vrw * np.sqrt(200.0), arw * np.sqrt(200.0)] == pytest.approx([rms * 10.0] * 2)
    walk = imu["GyroBiasStability"] / 3600.0 * degree / np.sqrt(imu["GyroBiasStabilityTau"])
    assert walk == pytest.approx(1e-5)
    assert imu["AccelBiasStability"] * 1e-6 * g / np.sqrt(imu["AccelBiasStabilityTau"]) == pytest.approx(1e-5)


def test_ros2_has_the_variance_of_a_sample() -> None:
    node = yaml.safe_load(written("ros2", noisy()))["/**"]["ros__parameters"]
    assert node["orientation_covariance"][0] == -1.0
    wanted = np.diag([(2e-3 * 10) ** 2, (3e-3 * 10) ** 2, (4e-3 * 10) ** 2]).ravel()
    assert node["linear_acceleration_covariance"] == pytest.approx(wanted.tolist())


def test_slow_noise_of_any_kind_becomes_the_walk_of_the_same_allan_deviation() -> None:
    """Against the Allan deviation that allantools measures on made noise."""
    allantools = pytest.importorskip("allantools")
    rng, dt, n, tau, sigma = np.random.default_rng(3), 1.0, 400_000, 60.0, 2e-3
    keep = np.exp(-dt / tau)
    values = lfilter([1.0], [1.0, -keep], rng.normal(0.0, sigma * np.sqrt(1.0 - keep**2), n))
    _, measured, _, _ = allantools.oadev(values, rate=1.0 / dt, data_type="freq", taus=[100.0])
    noise = SensorNoise(white=np.zeros(3), rate_hz=1.0, gauss_markov=((np.full(3, sigma), tau),))
    assert noise.walk_alike()[0] * np.sqrt(100.0 / 3.0) == pytest.approx(measured[0], rel=0.05)


def test_mavproxy_s_own_parser_reads_ardupilot_s_file(tmp_path: Path) -> None:
    mavparm = pytest.importorskip("pymavlink.mavparm", reason="needs pymavlink (extra conventions)")
    path = tmp_path / "imu.param"
    path.write_text(written("ardupilot", random_imu(3)))
    read = mavparm.MAVParmDict()
    assert read.load(str(path))
    assert dict(read) == parameters(path.read_text(), 0, 1)


def test_openvins_own_parser_reads_kalibr_s_file(tmp_path: Path) -> None:
    """It reads with OpenCV, kalibr with PyYAML."""
    cv2 = pytest.importorskip("cv2", reason="needs OpenCV (extra conventions)")
    path = tmp_path / "imu.yaml"
    path.write_text(written("kalibr", random_imu(3)))
    chain = yaml.safe_load(path.read_text())["imu0"]
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    node = storage.getNode("imu0")
    for key in ("Ta", "Tw", "Tg", "R_IMUtoACC", "R_IMUtoGYRO", "T_i_b"):
        rows = [[node.getNode(key).at(r).at(c).real() for c in range(3)] for r in range(3)]
        np.testing.assert_array_equal(rows, np.array(chain[key])[:3, :3])


def test_what_is_written_for_gazebo_is_sdf_by_its_schema() -> None:
    """The schema is of our own writing, from SDFormat's published descriptions (its head names them)."""
    xmlschema = pytest.importorskip("xmlschema", reason="needs xmlschema (extra conventions)")
    schema = xmlschema.XMLSchema(str(Path(__file__).parents[2] / "support" / "sdf_imu.xsd"))
    whole = written("gazebo", noisy())
    for text in (whole, written("gazebo", random_imu(3))):
        assert [str(error) for error in schema.iter_errors(text)] == []
    for right, wrong in (
        ("<stddev>0.0", "<stddev>-0.1"),
        ("stddev>", "std_dev>"),
        ("'gaussian'", "'normal'"),
        ("<mean>-0.2</mean>", "<mean>-0.2</mean><mean>0.2</mean>"),
        ("<mean>-0.2", "<mean>-0,2"),
        ("type='imu'", ""),
    ):
        assert right in whole
        assert not schema.is_valid(whole.replace(right, wrong)), (right, wrong)
