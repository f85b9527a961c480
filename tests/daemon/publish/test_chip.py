"""The calibration in the chip's registers, in a tree of files laid out as the kernel's sysfs-bus-iio says.

The driver of the ICM-42600 adds calibbias to its readings, which a file cannot do; `Chip` does it here.
"""

from __future__ import annotations

import asyncio
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from stillcal.daemon.app import Service
from stillcal.daemon.publish.chip import memory_path
from stillcal.daemon.settings import SettingsError
from stillcal.daemon.sources import chip_correction, sysfs
from stillcal.daemon.sources.chip_correction import ChipError
from tests.support.asking import stored
from tests.support.living import given_in, running, until, within_reason

LSB = 1e-4
TURNED = "0, 1, 0; -1, 0, 0; 0, 0, 1"
MOUNT = sysfs.matrix(TURNED)


class Chip:
    """An ICM-42605 as its driver shows it: two devices, SI registers, a range; mounted a quarter turn off."""

    def __init__(self, devices: Path, *, name: str = "icm42605", scale: bool = False) -> None:
        self.parts = {"in_accel": devices / "iio:device1", "in_anglvel": devices / "iio:device0"}
        for prefix, folder in self.parts.items():
            folder.mkdir(parents=True)
            kind = prefix.removeprefix("in_")
            self.put(prefix, "name", f"{name}-{kind}").rename(folder / "name")
            self.put(prefix, "mount_matrix", TURNED)
            self.put(prefix, "scale", LSB)
            self.put(prefix, "calibbias_available", "[-10.042010 0.004903 10.037106]")
            for axis in "xyz":
                self.put(prefix, f"{axis}_calibbias", "0.000000000")
                if scale:
                    self.put(prefix, f"{axis}_calibscale", "1.000000")
        self.feel([0.0, 0.0, 9.81], [0.0, 0.0, 0.0])

    def put(self, prefix: str, name: str, value: object) -> Path:
        path = self.parts[prefix] / f"{prefix}_{name}"
        path.write_text(f"{value}\n")
        return path

    def held(self, prefix: str, kind: str = "calibbias") -> np.ndarray:
        return np.array([float((self.parts[prefix] / f"{prefix}_{a}_{kind}").read_text()) for a in "xyz"])

    def feel(self, force: list[float], rate: list[float]) -> None:
        """Show what the chip feels (SI, its own axes) as it reads it: with its calibbias added."""
        for prefix, xyz in (("in_accel", force), ("in_anglvel", rate)):
            for axis, value in zip("xyz", np.array(xyz) + self.held(prefix), strict=True):
                self.put(prefix, f"{axis}_raw", round(value / LSB))


def config(devices: Path) -> str:
    return f'[source]\nkind = "iio"\nport = "{devices}"\n[publish]\nto = ["iio"]\n'


def corrected(chip: Chip, record: Any) -> bool:
    return bool(np.abs(chip.held("in_accel") + MOUNT.T @ record.accelerometer.bias).max() < 0.004)


async def lived(folder: Path, chip: Chip, check: Any) -> None:
    given = given_in(folder, config(folder / "devices"))
    async with running(type(given)(given.config, None, given.store, given.socket)) as service:
        await check(service)


def test_the_chip_corrects_while_the_daemon_runs_and_holds_what_it_did_before_afterwards(
    folder: Path, make_record: Any
) -> None:
    chip, record = Chip(folder / "devices"), make_record(3)
    chip.put("in_accel", "x_calibbias", "0.123000000")
    stored(folder, record)

    async def check(service: Service) -> None:
        await until(lambda: corrected(chip, record))
        assert np.abs(chip.held("in_anglvel") + MOUNT.T @ record.gyroscope.bias).max() < 1e-6
        assert memory_path(folder / "store.json").exists()

    within_reason(lived(folder, chip, check))
    assert chip.held("in_accel").tolist() == [0.123, 0, 0] and chip.held("in_anglvel").tolist() == [0, 0, 0]
    assert not memory_path(folder / "store.json").exists()


def test_what_the_daemon_reads_does_not_depend_on_the_registers(folder: Path, make_record: Any) -> None:
    chip = Chip(folder / "devices", scale=True)
    force, rate = [1.0, -2.0, 9.0], [0.1, 0.2, -0.3]
    chip.feel(force, rate)
    sensors = sysfs.find(folder / "devices")
    assert sensors.gyroscope is not None
    before = [channel.read() for channel in sensors.channels()]
    for channel in sensors.channels():
        assert channel.correct_chip(np.array([0.5, -0.25, 0.125]), np.eye(3), folder / "memory")
    chip.feel(force, rate)
    after = [channel.read() for channel in sensors.read_again().channels()]
    np.testing.assert_allclose(after, before, atol=2 * LSB)
    np.testing.assert_allclose(before[0], MOUNT @ force, atol=LSB)
    plain = [channel.read() for channel in sensors.channels()]
    np.testing.assert_allclose(np.array(plain) - before, [[-0.5, 0.25, -0.125]] * 2, atol=2 * LSB)


def test_scale_goes_to_calibscale_where_there_is_one_by_the_chips_axes(tmp_path: Path) -> None:
    chip = Chip(tmp_path / "devices", scale=True)
    accelerometer = sysfs.find(tmp_path / "devices").accelerometer
    accelerometer.correct_chip(np.zeros(3), np.diag([1.01, 0.98, 1.0]), tmp_path / "memory")
    assert chip.held("in_accel", "calibscale").tolist() == [0.98, 1.01, 1.0]
    assert not accelerometer.correct_chip(np.full(3, 0.003), np.diag([1.01, 0.98, 1.0]), tmp_path / "memory")
    assert accelerometer.correct_chip(np.full(3, 0.004), np.diag([1.01, 0.98, 1.0]), tmp_path / "memory")


def test_a_value_that_is_refused_leaves_none_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The kernel answers a write with an error; here the third of six files does."""
    chip = Chip(tmp_path / "devices")
    chip.put("in_accel", "x_calibbias", "0.5")
    write = Path.write_text

    def refusing(path: Path, text: str, **options: Any) -> int:
        if path.name == "in_accel_z_calibbias" and text.startswith("-"):
            raise OSError(22, "Invalid argument", str(path))
        return write(path, text, **options)

    monkeypatch.setattr(Path, "write_text", refusing)
    accelerometer = sysfs.find(tmp_path / "devices").accelerometer
    with pytest.raises(OSError, match="Invalid argument"):
        accelerometer.correct_chip(np.full(3, 0.2), np.eye(3), tmp_path / "memory")
    assert chip.held("in_accel").tolist() == [0.5, 0.0, 0.0]


@pytest.mark.parametrize(
    ("name", "bias", "said"),
    [
        ("icm42605", 11.0, "-11 is beyond its range, -10.042 to 10.0371"),
        ("adxl345", 0.1, "unit of its in_accel_x_calibbias is not known"),
    ],
)
def test_what_a_chip_cannot_hold_is_said_and_not_written(
    tmp_path: Path, name: str, bias: float, said: str
) -> None:
    chip = Chip(tmp_path / "devices", name=name)
    with pytest.raises(ChipError, match=said):
        sysfs.find(tmp_path / "devices").accelerometer.correct_chip(
            np.array([0, 0, bias]), np.eye(3), tmp_path / "memory"
        )
    assert chip.held("in_accel").tolist() == [0, 0, 0] and not (tmp_path / "memory").exists()


def test_after_a_kill_the_first_values_are_known_and_after_a_reboot_they_are_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    chip, memory = Chip(tmp_path / "devices"), tmp_path / "memory"
    chip.put("in_accel", "y_calibbias", "0.250000000")
    for bias in (1.0, 2.0):  # the second daemon finds what the first one left
        sysfs.find(tmp_path / "devices").accelerometer.correct_chip(np.full(3, bias), np.eye(3), memory)
    assert chip_correction.put_back(memory) and chip.held("in_accel").tolist() == [0, 0.25, 0]
    sysfs.find(tmp_path / "devices").accelerometer.correct_chip(np.full(3, 1.0), np.eye(3), memory)
    monkeypatch.setattr(chip_correction, "_boot", lambda: "another boot")
    assert chip_correction.put_back(memory) == [] and chip.held("in_accel")[0] != 0


def test_a_chip_that_lost_its_registers_is_noticed_when_the_sensors_wake(
    folder: Path, make_record: Any
) -> None:
    chip, record = Chip(folder / "devices"), make_record(3)
    stored(folder, record)

    async def check(service: Service) -> None:
        await until(lambda: corrected(chip, record))
        for axis in "xyz":
            chip.put("in_accel", f"{axis}_calibbias", "0.0")
        source: Any = service.source
        source._sleep(float("inf"))
        await asyncio.sleep(0.05)
        source._wake()
        await until(lambda: not source._woken)
        assert source._sensors.accelerometer.chip_bias.tolist() == [0, 0, 0]

    within_reason(lived(folder, chip, check))


def test_it_is_for_this_machines_own_sensors(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match=r'set kind = "iio" under \[source\]'):
        given_in(tmp_path, '[publish]\nto = ["iio"]\n').settings()


def test_files_that_may_not_be_written_are_said_and_the_daemon_goes_on(
    folder: Path, make_record: Any, caplog: pytest.LogCaptureFixture
) -> None:
    if os.geteuid() == 0:
        pytest.skip("root may write everything")
    chip = Chip(folder / "devices")
    stored(folder, make_record(3))
    for axis in "xyz":
        (chip.parts["in_accel"] / f"in_accel_{axis}_calibbias").chmod(0o444)

    async def check(service: Service) -> None:
        await until(lambda: "let the daemon's user write it" in caplog.text)
        assert not chip.held("in_accel").any()

    within_reason(lived(folder, chip, check))
