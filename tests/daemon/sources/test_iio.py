"""A Linux phone's own sensors, in a tree of files laid out as the kernel's sysfs-bus-iio describes it."""

from __future__ import annotations

import asyncio
import math
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from stillcal.calib_core.static.settings import Sense, Sleep
from stillcal.calib_core.streams.events import Temperature, Tick
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.daemon.app import Service
from stillcal.daemon.app_launch import LaunchOptions
from stillcal.daemon.settings import SettingsError
from stillcal.daemon.sources import iio, sysfs
from stillcal.daemon.sources.base import LinkDown, LinkUp, SerialSettings
from stillcal.daemon.sources.iio import IioSource
from stillcal.daemon.sources.sysfs import SensorGoneError, find, matrix
from stillcal.daemon.system.systemd import Notifier
from stillcal.daemon.wire.messages import Hello, Identify, Rate, Status
from tests.support.living import within_reason


def put(folder: Path, **files: object) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    for name, value in files.items():
        (folder / name).write_text(f"{value}\n")
    return folder


def imu(devices: Path, number: int = 1) -> Path:
    """An MPU-6050 as inv_mpu6050 shows it: one device with both sensors; screen up, turning about z."""
    return put(
        devices / f"iio:device{number}",
        name="mpu6050",
        in_accel_x_raw=0,
        in_accel_y_raw=0,
        in_accel_z_raw=16384,
        in_accel_scale=0.000598550,
        in_accel_mount_matrix="1, 0, 0; 0, 1, 0; 0, 0, 1",
        in_anglvel_x_raw=10,
        in_anglvel_y_raw=-20,
        in_anglvel_z_raw=1000,
        in_anglvel_scale=0.001064724,
        in_temp_raw=-4000,
        in_temp_offset=12420,
        in_temp_scale=2.941176,
        sampling_frequency=50,
    )


def light(devices: Path) -> None:
    put(devices / "iio:device0", name="stk3310", in_illuminance_raw=12)


def settings(devices: Path) -> SerialSettings:
    return SerialSettings(str(devices), retry_s=0.01, retry_max_s=0.05)


async def until(source: IioSource, found: Callable[[list[Any]], bool]) -> list[Any]:
    """Take until what has come satisfies `found`; return all of it."""
    records: list[Any] = []
    while not found(records):
        records += await source.take()
    return records


def of(kind: type, records: list[Any]) -> list[Any]:
    return [r for r in records if isinstance(r, kind)]


def samples(records: list[Any], sensor: Sensor) -> Samples:
    return Samples.joined(r for r in of(Samples, records) if r.sensor is sensor)


# Files


def test_values_are_raw_and_offset_times_scale_in_si(tmp_path: Path) -> None:
    light(tmp_path)
    put(imu(tmp_path), in_accel_x_offset=100, in_anglvel_scale=0.5)
    sensors = find(tmp_path)
    assert sensors.accelerometer.name == "mpu6050" and sensors.rate_hz == 50.0
    np.testing.assert_allclose(sensors.accelerometer.read(), [0.059855, 0, 9.8066432], rtol=1e-6)
    assert sensors.gyroscope is not None
    np.testing.assert_allclose(sensors.gyroscope.read(), [5, -10, 500])
    assert sensors.celsius() == pytest.approx(24.765, abs=1e-3)  # (-4000 + 12420) * 2.941176 / 1000


def test_two_devices_their_own_scales_and_a_mount_matrix(tmp_path: Path) -> None:
    accel = put(
        tmp_path / "iio:device3", name="bmc150", in_accel_scale=1, in_mount_matrix="0,1,0; -1,0,0; 0,0,1"
    )
    put(accel, in_accel_x_raw=1, in_accel_y_raw=2, in_accel_z_raw=3, in_accel_z_scale=10)
    put(tmp_path / "iio:device11", name="bmg160", in_anglvel_x_raw=1, in_anglvel_y_raw=2, in_anglvel_z_raw=3)
    sensors = find(tmp_path)
    assert sensors.accelerometer.read().tolist() == [2.0, -1.0, 30.0]
    assert sensors.gyroscope is not None and sensors.gyroscope.name == "bmg160"
    assert sensors.gyroscope.read().tolist() == [1.0, 2.0, 3.0] and sensors.celsius() is None


@pytest.mark.parametrize(
    ("files", "said"),
    [
        ({"in_accel_scale": 0}, "must be positive"),
        ({"in_accel_scale": "fast"}, "expected a number"),
        ({"in_accel_mount_matrix": "1, 0; 0, 1"}, "not a rotation"),
        ({"in_accel_mount_matrix": "2, 0, 0; 0, 1, 0; 0, 0, 1"}, "not a rotation"),
    ],
)
def test_files_that_make_no_sense_are_named(tmp_path: Path, files: dict[str, object], said: str) -> None:
    folder = put(imu(tmp_path), **files)
    with pytest.raises(SensorGoneError, match=said) as refusal:
        find(tmp_path)
    assert str(folder) in str(refusal.value)


def test_a_mount_matrix_is_read_by_rows() -> None:
    assert (matrix("0, 0, 1; 1, 0, 0; 0, 1, 0") @ [1.0, 2.0, 3.0]).tolist() == [3.0, 1.0, 2.0]


# The source


def test_it_is_a_phone_that_says_hello_and_sends_even_samples(tmp_path: Path) -> None:
    imu(tmp_path)

    async def test() -> None:
        async with IioSource(settings(tmp_path)) as source:
            records = await until(source, lambda r: sum(len(s) for s in of(Samples, r)) >= 50)
            assert isinstance(records[0], LinkUp) and records[0].device.endswith("iio:device1")
            (hello,) = of(Hello, records)
            assert hello.flow == "free" and hello.claims["device"] == "mpu6050"
            assert hello.claims["nominal_rate_hz"] == 50.0
            accel, gyro = samples(records, Sensor.ACCELEROMETER), samples(records, Sensor.GYROSCOPE)
            np.testing.assert_allclose(accel.xyz[:, 2], 9.8066432, rtol=1e-6)
            np.testing.assert_allclose(gyro.xyz[:, 2], 1.064724)
            assert (np.diff(accel.t) > 0).all() and (np.diff(gyro.t) > 0).all()
            (warm,) = of(Temperature, records)
            assert warm.celsius == pytest.approx(24.765, abs=1e-3)
            assert source.wire.samples == len(accel) + len(gyro)
        assert await source.take() != [] and await source.take() == []

    within_reason(test())


def test_while_the_sensors_sleep_the_thermometer_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(iio, "THERMOMETER_S", 0.05)
    folder = imu(tmp_path)

    async def test() -> None:
        async with IioSource(settings(tmp_path)) as source:
            records = await until(source, lambda r: len(of(Samples, r)) >= 2 and bool(of(Temperature, r)))
            end = of(Samples, records)[-1].t[-1]
            assert source.send(Sleep(end + 0.6))
            slept = await until(source, lambda r: len(of(Temperature, r)) >= 3)
            assert not of(Status, slept)[-1].sensing and source.connected
            woken = await until(source, lambda r: bool(of(Samples, r)))
            assert of(Status, woken)[-1].sensing and samples(woken, Sensor.ACCELEROMETER).t[0] >= end + 0.6
            source.send(Sleep(math.inf))
            shutil.rmtree(folder)
            (lost,) = of(LinkDown, await until(source, lambda r: bool(of(LinkDown, r))))
            assert "sensor lost" in lost.reason

    within_reason(test())


def test_it_sleeps_and_wakes_when_told_and_says_what_it_cost(tmp_path: Path) -> None:
    imu(tmp_path)

    async def test() -> None:
        async with IioSource(settings(tmp_path)) as source:
            records = await until(source, lambda r: len(of(Samples, r)) >= 2)
            end = of(Samples, records)[-1].t[-1]
            assert source.send(Sleep(end + 0.5))
            slept = await until(source, lambda r: bool(of(Tick, r)))
            assert not of(Status, slept)[-1].sensing
            stopped = of(Tick, slept)[-1].t
            woken = await until(source, lambda r: bool(of(Samples, r)))
            assert samples(woken, Sensor.ACCELEROMETER).t[0] >= end + 0.5 > stopped
            told = of(Status, woken)[0]
            assert (
                told.sensing
                and told.wakeups == 2
                and told.on_time < stopped - of(Samples, records)[0].t[0] + 0.5
            )
            source.send(Sleep(math.inf))
            await until(source, lambda r: bool(of(Tick, r)))
            source.send(Sense(math.inf))
            assert of(Samples, await until(source, lambda r: bool(of(Samples, r))))

    within_reason(test())


def test_a_rate_is_asked_of_the_chip_and_kept_to(tmp_path: Path) -> None:
    folder = imu(tmp_path)

    async def test() -> None:
        async with IioSource(settings(tmp_path)) as source:
            source.send(Rate(20.0))
            assert (folder / "sampling_frequency").read_text() == "20\n"
            await until(source, lambda r: len(of(Samples, r)) >= 2)
            source.send(Identify())
            records = await until(source, lambda r: len(of(Hello, r)) == 1 and len(of(Samples, r)) >= 6)
            assert of(Hello, records)[0].claims["nominal_rate_hz"] == 20.0
            steps = np.diff(samples(records, Sensor.ACCELEROMETER).t)
            assert np.median(steps) > 0.04  # not the 0.02 s of before; a busy machine only makes it longer

    within_reason(test())


@pytest.mark.parametrize("odd", ["nan", "1e300", "9" * 400])
def test_a_value_that_is_no_reading_is_a_loss_and_it_goes_on_once_it_is_one_again(
    tmp_path: Path, odd: str
) -> None:
    folder = imu(tmp_path)

    async def test() -> None:
        async with IioSource(settings(tmp_path)) as source:
            await until(source, lambda r: bool(of(Samples, r)))
            put(folder, in_anglvel_x_raw=odd)
            records = await until(source, lambda r: bool(of(LinkDown, r)))
            assert "is no reading" in of(LinkDown, records)[0].reason
            put(folder, in_anglvel_x_raw=10)
            await until(source, lambda r: bool(of(Samples, r)))

    within_reason(test())


def test_removed_while_reading_it_says_so_once_and_is_found_again(tmp_path: Path) -> None:
    folder = imu(tmp_path)

    async def test() -> None:
        async with IioSource(settings(tmp_path)) as source:
            await until(source, lambda r: bool(of(Samples, r)))
            shutil.rmtree(folder)
            records = await until(source, lambda r: len(of(LinkDown, r)) == 2)
            gone, missing = of(LinkDown, records)
            assert gone.device == str(folder) and "sensor lost" in gone.reason and "_raw" in gone.reason
            assert missing.device == "" and "no accelerometer" in missing.reason
            assert not source.connected and source.device == "" and not source.send(Identify())
            while source.link.failed_attempts < 4:
                await asyncio.sleep(0.01)
            imu(tmp_path, 2)
            back = await until(source, lambda r: bool(of(Samples, r)))
            (up,) = of(LinkUp, back)
            assert up.attempts >= 4 and not of(LinkDown, back)
            assert (source.link.disconnections, source.link.connections) == (1, 2)

    within_reason(test())


def test_nobody_who_takes_makes_it_pause_and_forget_nothing(tmp_path: Path) -> None:
    imu(tmp_path)

    async def test() -> None:
        full = SerialSettings(str(tmp_path), queue=4)
        async with IioSource(full) as source:
            while source.link.pauses < 2:
                await asyncio.sleep(0.01)
            assert len(await source.take()) <= 8
            assert await until(source, lambda r: bool(of(Samples, r)))

    within_reason(test())


# The daemon


def test_a_daemon_lives_on_the_machines_own_sensors(tmp_path: Path) -> None:
    imu(tmp_path / "devices")
    config = tmp_path / "c.toml"
    config.write_text(f'[source]\nkind = "iio"\nport = "{tmp_path / "devices"}"\n')

    async def test() -> None:
        given = LaunchOptions(config, None, str(tmp_path / "store.json"), str(tmp_path / "socket"))
        service = Service(given.settings(), given, Notifier({}))
        service.open()
        task = asyncio.create_task(service.run())
        while not service.saved.energy.days or service.saved.energy.days[-1].samples < 100:
            await asyncio.sleep(0.01)
        assert service.saved.device == "mpu6050" and "iio:device1" in service.describe()
        service.stop()
        await task

    within_reason(test())


def test_without_a_folder_it_is_the_kernels_and_another_kind_is_refused(tmp_path: Path) -> None:
    config = tmp_path / "c.toml"
    config.write_text('[source]\nkind = "iio"\n')
    assert LaunchOptions(config).settings().source.port == ""
    assert sysfs.DEVICES == "/sys/bus/iio/devices"
    config.write_text('[source]\nkind = "usb"\n')
    with pytest.raises(SettingsError, match="one of 'serial', 'iio'"):
        LaunchOptions(config).settings()
