"""Commands on files run where Linux's own calls are missing; the others say so in one line.

tests/support/without_posix takes away what Windows and macOS lack. Each command runs in a process of its own.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support import without_posix

TAKEN_AWAY = str(Path(without_posix.__file__).parent)


def stillcal(folder: Path, *arguments: str, first: str = "") -> subprocess.CompletedProcess[str]:
    """Run `stillcal` without POSIX. first: packages that are built for this host and keep what they need."""
    command = [sys.executable, "-c", "from stillcal.daemon.cli.main import main; main()", *arguments]
    environ = os.environ | {"PYTHONPATH": TAKEN_AWAY, "BUILT_FOR_HOST": first}
    return subprocess.run(
        command, cwd=folder, env=environ, capture_output=True, text=True, timeout=300, check=False
    )


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a simulated recording and the store that a replay of it leaves."""
    made = tmp_path_factory.mktemp("without_posix")
    for line in (
        "simulate lab --out lab.csv --seed 7",
        "replay lab.csv --store store.json --json calibration.json",
    ):
        done = stillcal(made, *line.split())
        assert done.returncode == 0, done.stderr
    return made


def test_what_is_taken_away_is_away(folder: Path) -> None:
    code = "import os, socket, fcntl"
    environ = os.environ | {"PYTHONPATH": TAKEN_AWAY}
    done = subprocess.run([sys.executable, "-c", code], env=environ, capture_output=True, check=False)
    assert b"No module named 'fcntl'" in done.stderr
    code = "import os, socket, time; print(hasattr(os, 'fchmod'), hasattr(socket, 'AF_UNIX'))"
    done = subprocess.run([sys.executable, "-c", code], env=environ, capture_output=True, check=False)
    assert done.stdout == b"False False\n"


@pytest.mark.parametrize(
    "line",
    [
        "--help",
        "run --help",
        "apply lab.csv --store store.json --out corrected.csv",
        "plot lab.csv --out lab.png",
        "store show store.json",
        "store history store.json",
        "store verify store.json",
        "install-service --print",
    ],
)
def test_a_command_on_files_runs(folder: Path, line: str) -> None:
    done = stillcal(folder, *line.split())
    assert (done.returncode, done.stderr) == (0, "")


def test_the_python_interface_runs(folder: Path) -> None:
    code = (
        "import stillcal; r = stillcal.load('lab.csv'); print(stillcal.calibrate(r).accelerometer.parameters)"
    )
    environ = os.environ | {"PYTHONPATH": TAKEN_AWAY}
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=folder, env=environ, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stdout) == (0, "9\n"), done.stderr


def test_the_calibration_is_the_same_as_here(folder: Path) -> None:
    here = [sys.executable, "-c", "from stillcal.daemon.cli.main import main; main()"]
    subprocess.run([*here, "replay", "lab.csv", "--json", "here.json", "--quiet"], cwd=folder, check=True)
    assert (folder / "here.json").read_text() == (folder / "calibration.json").read_text()


def test_a_store_is_locked_against_a_second_writer(folder: Path) -> None:
    code = """
import subprocess, sys
from stillcal.daemon.store.store import Store
with Store("store.json"):
    sys.exit(subprocess.call([sys.executable, *sys.argv[1:]]))
"""
    inner = ["-c", "from stillcal.daemon.cli.main import main; main()", "store", "rollback", "store.json"]
    done = subprocess.run(
        [sys.executable, "-c", code, *inner],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": TAKEN_AWAY},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2 and "is in use by process" in done.stderr
    after = stillcal(folder, "store", "rollback", "store.json")
    assert "in use" not in after.stderr and "cannot roll back" in after.stderr


@pytest.mark.slow
def test_a_diagnosis_runs_with_all_its_outputs(folder: Path) -> None:
    outputs = ["--json", "d.json", "--report", "d.html", "--phone-out", "phone.toml"]
    done = stillcal(folder, "diagnose", "lab.csv", *outputs)
    assert (done.returncode, done.stderr) == (0, "")
    assert all((folder / name).stat().st_size for name in ("d.json", "d.html", "phone.toml"))


@pytest.mark.slow
def test_a_fleet_runs(folder: Path) -> None:
    pytest.importorskip("distributed")
    arguments = ["--out", "results", "--no-diagnosis", "--workers", "1"]
    done = stillcal(folder, "fleet", "lab.csv", *arguments, first="distributed")
    assert (done.returncode, done.stderr) == (0, "")
    report = stillcal(folder, "fleet-report", "results", first="distributed")
    assert report.returncode == 0 and "1 calibrated" in report.stdout


@pytest.mark.parametrize(
    ("line", "lacking"),
    [
        ("run --port nowhere", "socket.AF_UNIX"),
        ("query", "socket.AF_UNIX"),
        ("watch --once", "socket.AF_UNIX"),
        ("simulate lab --serial", "os.openpty"),
    ],
)
def test_what_needs_more_says_so_in_one_line(folder: Path, line: str, lacking: str) -> None:
    done = stillcal(folder, *line.split())
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.count("\n") == 1 and "needs Linux" in done.stderr and lacking in done.stderr
