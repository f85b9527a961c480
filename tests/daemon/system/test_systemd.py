"""The units, judged by systemd's own tools, and the daemon started by its socket."""

from __future__ import annotations

import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import varlink

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


def test_printing_changes_nothing(tmp_path: Path) -> None:
    found = run(STILLCAL, "install-service", "--print", "--root", tmp_path)
    assert "[Service]" in found.stdout and not list(tmp_path.iterdir())


def test_systemd_has_nothing_to_say_against_the_units(installed: Path) -> None:
    units = sorted((installed / "etc/systemd/system").iterdir())
    found = run(need("systemd-analyze"), "verify", "--man=no", *units)
    assert (found.returncode, found.stdout, found.stderr) == (0, "", "")


def test_the_service_is_hardened(installed: Path) -> None:
    unit = installed / "etc/systemd/system/stillcal.service"
    found = run(need("systemd-analyze"), "security", "--offline=true", "--threshold=15", "--no-pager", unit)
    exposure = re.search(r"Overall exposure level for \S+: ([\d.]+)", found.stdout)
    assert exposure is not None, found.stderr
    assert float(exposure[1]) <= 1.5 and found.returncode == 0
    assert "DeviceAllow=char-ttyACM rw" in unit.read_text()


def test_the_rule_is_good(installed: Path) -> None:
    found = run(need("udevadm"), "verify", installed / "etc/udev/rules.d/70-stillcal.rules")
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
