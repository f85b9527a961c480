"""`-`: files on standard output and standard input, so that commands can be joined by pipes."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from click.testing import CliRunner

from stillcal.daemon.store.atomic import write_atomically
from stillcal.daemon.store.files import StoreError
from stillcal.replay.commands.outputs import write_output
from stillcal.replay.commands.reading import Reading
from stillcal.replay.commands.store_files import import_command
from stillcal.replay.formats.errors import TraceError
from stillcal.replay.formats.writer import TraceWriter
from stillcal.replay.outcome import current_in_store
from tests.support.command_line import ran

STILLCAL = str(Path(sys.executable).with_name("stillcal"))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("pipes")
    assert ran("replay", "sample:lab", "--store", made / "store.json", "--quiet").returncode == 0
    assert ran("convert", "sample:lab", "--to", 30, "--out", made / "short.csv", "--quiet").returncode == 0
    return made


def test_a_recording_goes_through_pipes_as_through_files(folder: Path) -> None:
    whole = (folder / "short.csv").read_bytes()
    piped = ran("convert", "-", "--out", "-", given=whole)
    assert (piped.returncode, piped.stdout) == (0, whole)
    assert b"standard output: " in piped.stderr
    ran("apply", folder / "short.csv", "--store", folder / "store.json", "--out", folder / "true.csv")
    piped = ran("apply", "-", "--store", folder / "store.json", "--out", "-", given=whole)
    assert (piped.returncode, piped.stdout) == (0, (folder / "true.csv").read_bytes())


def test_a_store_is_read_from_a_pipe(folder: Path) -> None:
    store = folder / "store.json"
    whole = store.read_bytes()
    for words in (("show",), ("verify",), ("history", "--json"), ("export", "--to", "px4", "--out", "-")):
        command, *options = words
        piped = ran("store", command, "-", *options, given=whole)
        named = ran("store", command, store, *options)
        assert piped.returncode == 0, piped.stderr
        shown = named.stdout.replace(bytes(store), b"store.json").splitlines()
        shown = [line for line in shown if b".last-good" not in line]
        assert piped.stdout.replace(b"standard input", b"store.json").splitlines() == shown
    corrected = ("apply", folder / "short.csv", "--out", "-", "--store")
    assert ran(*corrected, "-", given=whole).stdout == ran(*corrected, store).stdout != b""


@pytest.mark.parametrize(
    ("words", "given", "said"),
    [
        (("store", "show", "-"), b"{}", b"standard input cannot be used as a store ("),
        (("store", "export", "-", "--to", "px4", "--out", "-"), b"", b"standard input cannot be used"),
        (("store", "rollback", "-"), b"", b"a store on standard input cannot be changed"),
        (("apply", "-", "--store", "-", "--out", "-"), b"", b"cannot be both the recording and the store"),
    ],
)
def test_what_cannot_be_a_store_on_standard_input_is_refused(
    tmp_path: Path, words: tuple[str, ...], given: bytes, said: bytes
) -> None:
    command = [STILLCAL, *words]
    refused = subprocess.run(command, input=given, capture_output=True, check=False, cwd=tmp_path)
    assert (refused.returncode, refused.stdout, refused.stderr.count(b"\n")) == (2, b"", 1), refused.stderr
    assert said in refused.stderr
    assert not list(tmp_path.iterdir())


REST_TABLE = b"ax,ay,az\n0,0,9.9\n0,0,-9.7\n0,9.81,0\n0,-9.81,0\n9.81,0,0\n-9.81,0,0\n"


def test_a_rest_table_comes_through_a_pipe_as_from_a_file(tmp_path: Path) -> None:
    (tmp_path / "r.csv").write_bytes(REST_TABLE)
    of_file = ran("replay", tmp_path / "r.csv", "--json", "-")
    assert of_file.returncode == 0 and b'"bias"' in of_file.stdout
    assert ran("replay", "-", "--json", "-", given=REST_TABLE).stdout == of_file.stdout
    reading, writing = os.pipe()
    os.write(writing, REST_TABLE)
    os.close(writing)
    named = [STILLCAL, "replay", f"/dev/fd/{reading}", "--json", "-"]
    piped = subprocess.run(named, capture_output=True, pass_fds=[reading], check=False)
    assert piped.stdout == of_file.stdout
    os.close(reading)
    few = ran("diagnose", "-", given=REST_TABLE)
    assert few.returncode == 3 and few.stderr.startswith(
        b"stillcal: too little data: standard input: 6 rests"
    )
    short = ran("diagnose", "-", given=b"t,ax,ay,az\n0,0,0,9.8\n1,0,0,9.8\n")
    assert short.returncode == 3 and short.stderr.startswith(
        b"stillcal: too little data: standard input: 2 samples"
    )
    bad = ran("replay", "-", "--format", "rest", given=b"ax,ay,az\n0,0,0\n0,0,0\n")
    assert bad.returncode == 2 and bad.stderr.startswith(b"stillcal: standard input: all rests read zero")


def test_a_store_from_a_pipe_is_drawn_as_from_its_file(folder: Path) -> None:
    store = (folder / "store.json").read_bytes()
    command = f"{STILLCAL} plot <(cat {folder / 'store.json'}) --what history --out -"
    named = subprocess.run(["bash", "-c", command], capture_output=True, check=False)
    assert named.returncode == 0 and named.stdout.startswith(b"\x89PNG"), named.stderr
    piped = ran("plot", "-", "--what", "history", "--out", "-", given=store)
    assert piped.returncode == 0 and piped.stdout.startswith(b"\x89PNG")
    broken = ran("plot", "-", "--out", "-", given=store.replace(b'"checksum"', b'"sum"'))
    assert broken.returncode == 2 and b"standard input cannot be used as a store" in broken.stderr


def test_settings_of_a_simulation_come_through_a_pipe() -> None:
    scenario = b'duration_s = 2.0\n[[segment]]\nactivity = "rest"\nduration_s = 2.0\n'
    made = ran("simulate", "-", "--out", "-", given=scenario)
    assert made.returncode == 0 and made.stdout.startswith(b"t,ax,ay,az"), made.stderr
    assert made.stderr.endswith(b"2 s of standard input, phone typical, seed 0\n")
    bad = ran("simulate", "lab", "--phone", "-", "--out", "-", given=b"a = 1\n")
    assert bad.returncode == 2 and b"standard input: Object" in bad.stderr
    both = ran("simulate", "-", "--phone", "-", "--out", "-", given=scenario)
    assert both.returncode == 2 and b"standard input ('-') can be one file only" in both.stderr


MAP = b'[time]\ncolumn = "t"\n[accelerometer]\ncolumns = ["ax", "ay", "az"]\nunit = "m/s^2"\n'


def test_a_column_map_and_settings_come_through_a_pipe(folder: Path) -> None:
    convert = ("convert", folder / "short.csv", "--out", "-", "--format")
    mapped = ran(*convert, "-", given=MAP)
    assert mapped.returncode == 0 and mapped.stdout.startswith(b"t,ax,ay,az\n"), mapped.stderr
    bad = ran(*convert, "-", given=b"[time]\n")
    assert bad.returncode == 2 and bad.stderr.startswith(b"stillcal: standard input: not a valid column map")
    table = ("replay", "-", "--format", "rest", "--config")
    both = ran(*table, "-", given=MAP)
    assert both.returncode == 2 and b"standard input ('-') can be one file only" in both.stderr
    set_so = ran("replay", folder / "short.csv", "--config", "-", given=b"[engine]\nmode = 3\n")
    assert set_so.returncode == 2 and set_so.stderr.startswith(b"stillcal: standard input:2: "), set_so.stderr


def test_what_a_pipe_gave_goes_to_no_other_load(tmp_path: Path) -> None:
    """A command that fails after a look at its pipe had left what it gave to the next one of that name."""
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    for first in (b"0.1", b"0.2"):
        text = REST_TABLE.replace(b"9.9", first)
        threading.Thread(target=pipe.write_bytes, args=[text], daemon=True).start()
        reading = Reading()
        assert reading.is_rest_table(pipe)
    assert reading.rest_table(pipe).rests[0].specific_force[2] == 0.2
    assert len(reading.rest_table(pipe).rests) == 6, "the same reading gives its bytes again"


def test_a_diagnosis_comes_through_a_pipe(folder: Path, tmp_path: Path) -> None:
    store = (folder / "store.json").read_bytes()
    (tmp_path / "store.json").write_bytes(store)
    finding = {
        "effect": "gyro_bias_temperature",
        "sensor": "gyro",
        "parameters": {"slope": {"value": [1e-4, 0.0, 0.0]}},
        "reference": {"temperature_c": 25.0},
    }
    given = json.dumps({"findings": [finding]}).encode()
    adopted = ran("store", "adopt-terms", tmp_path / "store.json", "-", given=given)
    assert adopted.returncode == 0 and b"now corrects gyro_bias_temperature" in adopted.stdout, adopted.stderr
    for other in (b"{}", b'{"findings": 3}', b'{"findings": [3]}'):
        bad = ran("store", "adopt-terms", tmp_path / "store.json", "-", given=other)
        assert bad.returncode == 2 and bad.stderr.startswith(b"stillcal: standard input: not a diagnosis")
    assert ran("store", "history", "-", given=store).stdout.split()[:2] == [b"standard", b"input"]


def test_a_calibration_goes_to_a_tool_and_back_through_a_pipe(folder: Path) -> None:
    store, back = folder / "store.json", folder / "back.json"
    exported = ran("store", "export", store, "--to", "npz", "--out", "-")
    into = CliRunner()
    taken = into.invoke(import_command, [str(back), "--from", "npz", "--in", "-"], input=exported.stdout)
    assert taken.exit_code == 0, taken.output
    first, second = (json.loads(path.read_text()) for path in (store, back))
    assert second["accelerometer"]["bias"] == pytest.approx(first["accelerometer"]["bias"], abs=1e-12)
    command = [str(folder / "none.json"), "--from", "npz", "--in", "-"]
    broken = into.invoke(import_command, command, input=b"PK\3\4").exception
    assert str(broken).startswith("standard input: ")
    assert not (folder / "none.json").exists()


def test_a_device_or_a_pipe_is_written_into_and_never_replaced(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A pipe stands for /dev/null here, which a test must not put at risk."""
    pipe, table = tmp_path / "pipe", tmp_path / "pipe.csv"
    os.mkfifo(pipe)
    os.mkfifo(table)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    write_output(pipe, b"{}")
    assert os.read(reader, 10) == b"{}"
    os.close(reader)
    with pytest.raises(OSError, match="is no regular file"):
        write_atomically(pipe, b"{}")
    with pytest.raises(TraceError, match="is no regular file"), TraceWriter(table):
        pass
    monkeypatch.setattr("stillcal.daemon.system.files.FIRST_WRITER_S", 0.1)
    with pytest.raises(StoreError, match="nobody writes to this pipe"):
        current_in_store(pipe)
    said = ran("replay", folder / "short.csv", "--store", pipe, "--quiet")
    assert said.returncode == 2 or said.returncode == 3, said.stderr
    assert pipe.is_fifo()
    assert table.is_fifo()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["pipe", "pipe.csv"]


def into_full_device(*words: object) -> tuple[int, str]:
    """Return the exit code of a command whose standard output is full, and what it says."""
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONUNBUFFERED"}  # as users have it
    with Path("/dev/full").open("wb") as full:
        command = [STILLCAL, *map(str, words)]
        said = subprocess.run(
            command, stdout=full, stderr=subprocess.PIPE, text=True, env=environment, check=False
        )
    return said.returncode, said.stderr


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="has no device that is always full")
def test_an_output_that_is_full_is_named(folder: Path) -> None:
    store = folder / "store.json"
    full = "stillcal: standard output: No space left on device\n"
    assert into_full_device("store", "show", store) == (2, full)
    assert into_full_device("--help") == (2, full)
    export = ("store", "export", store, "--to", "px4", "--out")
    assert into_full_device(*export, "-") == (2, full)
    assert into_full_device(*export, "/dev/full") == (2, full.replace("standard output", "/dev/full"))
    code, said = into_full_device("convert", folder / "short.csv", "--out", "-", "--quiet")
    assert code == 2
    assert said.startswith("stillcal: standard output: cannot be written (No space left on device); lead it ")
    assert said.count("\n") == 1


def test_stages_are_shown_on_a_terminal_with_their_share_and_nowhere_else() -> None:
    code = (
        "import time; from stillcal.daemon.cli.progress import stages\n"
        "with stages(False) as show: show('examining walk.csv', 0.37); time.sleep(0.3)"
    )
    ours, theirs = os.openpty()
    environment = os.environ | {"TERM": "xterm", "COLUMNS": "120"}
    subprocess.run([sys.executable, "-c", code], stderr=theirs, env=environment, check=True)
    shown = os.read(ours, 1 << 16)
    os.close(theirs)
    os.close(ours)
    assert b"examining walk.csv" in shown
    assert b" 37%" in shown
    piped = subprocess.run([sys.executable, "-c", code], capture_output=True, env=environment, check=True)
    assert piped.stderr.strip() == b""


def test_a_link_stays_one_and_its_file_is_written(folder: Path, tmp_path: Path) -> None:
    kept, links = tmp_path / "kept", tmp_path / "links"
    kept.mkdir()
    links.mkdir()
    outputs = {name: kept / f"of-{name}" for name in ("r.csv", "r.json", "p.parquet", "s.json", "d.json")}
    for name, file in outputs.items():
        (links / name).symlink_to(file)
    (links / "loop.csv").symlink_to(links / "loop.csv")
    for out in ("r.csv", "p.parquet"):
        assert ran("convert", folder / "short.csv", "--out", links / out, "--quiet").returncode == 0
    assert ran("replay", "sample:lab", "--store", links / "s.json", "--quiet").returncode == 0
    assert ran("replay", "sample:lab", "--json", links / "d.json", "--quiet").returncode == 0
    assert all((links / name).is_symlink() for name in outputs)
    assert outputs["r.csv"].read_bytes() == (folder / "short.csv").read_bytes()
    assert outputs["p.parquet"].read_bytes().startswith(b"PAR1")
    assert json.loads(outputs["s.json"].read_text())["accelerometer"]
    assert json.loads(outputs["d.json"].read_text())["accelerometer"]
    refused = ran("convert", "sample:lab", "--out", links / "loop.csv", "--quiet")
    assert refused.returncode == 2
    assert len(refused.stderr.splitlines()) == 1
    assert not [path for path in (*kept.iterdir(), *links.iterdir()) if path.suffix in (".tmp", ".part")]


def test_standard_output_takes_one_file_and_is_left_by_its_reader_in_peace(folder: Path) -> None:
    both = ran("diagnose", folder / "short.csv", "--json", "-", "--phone-out", "-")
    assert (both.returncode, both.stdout) == (2, b"")
    assert len(both.stderr.splitlines()) == 1
    assert not list(Path.cwd().glob("-*"))
    command = f"{STILLCAL} simulate lab --out - | head -n 1"
    left = subprocess.run(["sh", "-c", command], capture_output=True, check=False)
    assert (left.stdout[:11], left.stderr) == (b"t,ax,ay,az,", b"")
