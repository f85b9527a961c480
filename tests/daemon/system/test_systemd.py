"""The units, judged by systemd's own tools, and the daemon started by its socket."""

from __future__ import annotations

import importlib.resources
import os
import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import varlink
from click.testing import CliRunner

from stillcal.daemon.cli import install
from stillcal.daemon.cli.install import install_command
from stillcal.daemon.publish import uinput
from stillcal.daemon.settings import SettingsError, load_settings

STILLCAL = Path(sys.executable).with_name("stillcal")


def need(tool: str) -> str:
    found = shutil.which(tool)
    if found is None:
        pytest.skip(f"{tool} is not installed here")
    return found


def run(*command: Any) -> subprocess.CompletedProcess[str]:
    return subprocess.run([*map(str, command)], capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("root")
    found = run(STILLCAL, "install-service", "--root", root, "--port", "/dev/ttyUSB7")
    assert found.returncode == 0, found.stderr
    return root


def test_what_is_installed_is_for_this_installation(installed: Path) -> None:
    unit = (installed / "etc/systemd/system/stillcal.service").read_text()
    assert f"ExecStart={STILLCAL} run" in unit
    settings = installed / "etc/stillcal/stillcal.toml"
    assert 'port = "/dev/ttyUSB7"' in settings.read_text()
    settings.write_text("# mine\n")
    assert "exists, not changed" in run(STILLCAL, "install-service", "--root", installed).stdout
    assert settings.read_text() == "# mine\n"


def test_the_sockets_group_is_as_asked_and_must_be_one(tmp_path: Path) -> None:
    found = run(STILLCAL, "install-service", "--print", "--socket-group", "sensors")
    assert "SocketGroup=sensors\n" in found.stdout and "SocketGroup=dialout" not in found.stdout
    for name in ("two words", "a\nb", ""):
        found = run(STILLCAL, "install-service", "--root", tmp_path, "--socket-group", name)
        assert found.returncode == 2 and not list(tmp_path.iterdir())


def test_every_user_may_be_let_in(tmp_path: Path) -> None:
    found = run(STILLCAL, "install-service", "--root", tmp_path, "--all-users")
    assert found.returncode == 0, found.stderr
    unit = tmp_path / "etc/systemd/system/stillcal.socket"
    assert "SocketMode=0666\n" in unit.read_text() and "0660" not in unit.read_text()
    found = run(STILLCAL, "install-service", "--print", "--all-users", "--socket-group", "users")
    assert found.returncode == 2 and "leave out --socket-group" in found.stderr


def test_the_group_is_one_that_the_system_has(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Arch has no dialout; systemd starts no unit with a group that is not there (status 216)."""

    def only_uucp(name: str) -> int:
        if name == "uucp":
            return 10
        raise SettingsError(f"[socket] group = {name!r}: this system has no such group")

    monkeypatch.setattr(install, "group_id", only_uucp)
    result = CliRunner().invoke(install_command, ["--print", "--iio"])
    assert result.exit_code == 0 and "dialout" not in result.output
    for line in ("SupplementaryGroups=uucp", "SocketGroup=uucp", 'GROUP="uucp"', "chgrp uucp"):
        assert line in result.output
    result = CliRunner().invoke(install_command, ["--print", "--group", "sensors", "--socket-group", "users"])
    assert "SupplementaryGroups=sensors\n" in result.output and "SocketGroup=users\n" in result.output
    result = CliRunner().invoke(install_command, ["--group", "sensors"])
    assert result.exit_code == 2 and "--group 'sensors': this system has no such group" in result.output


def test_an_input_device_is_let_through_and_readable_by_who_is_logged_in(tmp_path: Path) -> None:
    found = run(STILLCAL, "install-service", "--root", tmp_path, "--uinput")
    assert found.returncode == 0, found.stderr
    units = tmp_path / "etc/systemd/system"
    assert "DeviceAllow=/dev/uinput rw" in (units / "stillcal.service.d/stillcal-uinput.conf").read_text()
    assert (tmp_path / "etc/modules-load.d/stillcal-uinput-module.conf").read_text().endswith("\nuinput\n")
    rules = tmp_path / "etc/udev/rules.d/71-stillcal-uinput.rules"
    assert f'ATTRS{{name}}=="{uinput.NAME.decode()}", TAG+="uaccess"' in rules.read_text()
    assert load_settings(tmp_path / "etc/stillcal/stillcal.toml").publish.to == ("uinput",)
    services = [units / "stillcal.service", units / "stillcal.socket"]
    verified = run(need("systemd-analyze"), "verify", "--man=no", *services)
    assert (verified.returncode, verified.stdout, verified.stderr) == (0, "", "")
    again = run(STILLCAL, "install-service", "--root", tmp_path, "--uinput")
    assert "toml: exists, not changed\n" in again.stdout, "it has what is needed"
    assert "modprobe uinput && udevadm control --reload" in again.stdout
    settings = tmp_path / "etc/stillcal/stillcal.toml"
    settings.write_text('[source]\nport = "/dev/ttyS0"\n')
    again = run(STILLCAL, "install-service", "--root", tmp_path, "--uinput")
    told = 'not changed; add as its first line what --uinput needs: publish.to = ["uinput"]'
    assert told in again.stdout
    settings.write_text('publish.to = ["uinput"]\n' + settings.read_text())
    assert load_settings(settings).publish.to == ("uinput",)


def test_printing_changes_nothing(tmp_path: Path) -> None:
    found = run(STILLCAL, "install-service", "--print", "--root", tmp_path)
    assert "[Service]" in found.stdout and not list(tmp_path.iterdir())


def test_systemd_has_nothing_to_say_against_the_units(installed: Path) -> None:
    units = sorted((installed / "etc/systemd/system").iterdir())
    found = run(need("systemd-analyze"), "verify", "--man=no", *units)
    assert (found.returncode, found.stdout, found.stderr) == (0, "", "")


ODD = [" ", "%h", "$HOME", ";", "ü", "'", '"', "\\", "\t", "\n", "\x7f", "\udcff"]


@pytest.mark.parametrize("odd", ODD, ids=ascii)
def test_a_folder_that_systemd_cannot_run_from_is_refused_and_no_other(
    odd: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    command = tmp_path / f"a{odd}b" / "stillcal"
    command.parent.mkdir()
    command.symlink_to("/bin/true")
    monkeypatch.setattr(sys, "argv", [str(command)])
    result = CliRunner().invoke(install_command, ["--root", str(tmp_path / "root")])
    if result.exit_code == 0:
        units = [tmp_path / "root/etc/systemd/system" / f"stillcal.{kind}" for kind in ("service", "socket")]
        found = run(need("systemd-analyze"), "verify", "--man=no", *units)
        assert (found.returncode, found.stderr) == (0, "")
    else:
        assert result.exit_code == 2 and "install stillcal in a folder without them" in result.output
        assert odd in ODD[5:] and not (tmp_path / "root").exists()


def test_a_handheld_may_write_its_own_sensors_files_and_systemd_agrees(tmp_path: Path) -> None:
    """The rule's command is run as udev runs it, on files laid out like the kernel's."""
    found = run(STILLCAL, "install-service", "--root", tmp_path, "--iio")
    assert found.returncode == 0, found.stderr
    units = tmp_path / "etc/systemd/system"
    drop_in = (units / "stillcal.service.d/stillcal-iio.conf").read_text()
    assert "ProtectKernelTunables=no" in drop_in
    rule = (tmp_path / "etc/udev/rules.d/71-stillcal-iio.rules").read_text()
    device = tmp_path / "sys/devices/iio:device0"
    device.mkdir(parents=True)
    for name in ("sampling_frequency", "in_accel_x_calibbias", "in_accel_x_raw"):
        (device / name).write_text("0")
        (device / name).chmod(0o644)
    command = re.search(r"RUN\+=\"/bin/sh -c '(.*)'\"", rule)
    assert command is not None
    script = command[1].replace("/sys%p", str(device)).replace("$$", "$")
    script = script.replace("chgrp dialout", f"chgrp {os.getegid()}")
    subprocess.run(["/bin/sh", "-c", script], check=True)
    written = sorted(path.name for path in device.iterdir() if path.stat().st_mode & 0o020)
    assert written == ["in_accel_x_calibbias", "sampling_frequency"]
    services = [units / "stillcal.service", units / "stillcal.socket"]
    verified = run(need("systemd-analyze"), "verify", "--man=no", *services)
    assert (verified.returncode, verified.stdout, verified.stderr) == (0, "", "")


def test_the_service_is_hardened(installed: Path) -> None:
    unit = installed / "etc/systemd/system/stillcal.service"
    found = run(need("systemd-analyze"), "security", "--offline=true", "--threshold=15", "--no-pager", unit)
    exposure = re.search(r"Overall exposure level for \S+: ([\d.]+)", found.stdout)
    assert exposure is not None, found.stderr
    assert float(exposure[1]) <= 1.5 and found.returncode == 0
    assert "DeviceAllow=char-ttyACM rw" in unit.read_text()


def test_the_rules_are_good() -> None:
    shipped = Path(str(importlib.resources.files("stillcal.config"))) / "systemd"
    found = run(need("udevadm"), "verify", *shipped.glob("*.rules"))
    if "verify" not in run(need("udevadm"), "--help").stdout:
        pytest.skip("this udevadm cannot verify rules")
    assert found.returncode == 0, found.stderr


def test_a_question_starts_the_daemon(tmp_path: Path) -> None:
    """systemd-socket-activate listens, and starts it with the listening socket as file 3."""
    tool, address = need("systemd-socket-activate"), tmp_path / "socket"
    service = [STILLCAL, "run", "--port", tmp_path / "no-phone", "--store", tmp_path / "store.json"]
    with subprocess.Popen(
        [tool, "--listen", str(address), *map(str, service)], stderr=subprocess.PIPE
    ) as process:
        try:
            assert process.stderr is not None
            assert b"Listening on" in process.stderr.readline()
            with (
                varlink.Client(address=f"unix:{address}") as client,
                client.open("io.stillcal.Calibration") as opened,
            ):
                status = opened.GetStatus()["status"]
            assert status["store"] == str(tmp_path / "store.json")
            process.send_signal(signal.SIGTERM)
            assert process.wait(30) == 0
            assert address.exists()
        finally:
            process.kill()
