"""`stillcal replay` and `stillcal apply` as a person or a script would use them."""

from __future__ import annotations

import gzip
import json
import math
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import stillcal.config
from stillcal.calib_core.streams.resample import median_rate_hz
from stillcal.calib_core.streams.smoothing import window_for
from stillcal.daemon.cli import main as cli
from stillcal.daemon.store.store import Store
from stillcal.replay.formats.trace import read_all

Ran = tuple[int, str, str]
Run = Callable[..., Ran]


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Run:
    """Run the command line in this process; return its exit code, standard output and standard error."""

    def _run(*words: object) -> Ran:
        monkeypatch.setattr(sys, "argv", ["stillcal", *map(str, words)])
        with pytest.raises(SystemExit) as ended:
            cli.main()
        out, err = capfd.readouterr()
        return ended.value.code or 0, out, err  # type: ignore[return-value]

    return _run


@pytest.fixture(scope="session")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A simulated phone calibrated by hand, as CSV."""
    path = tmp_path_factory.mktemp("lab") / "lab.csv"
    words = ["simulate", "lab", "--out", str(path), "--seed", "1"]
    cli.cli.main(words, standalone_mode=False)
    return path


@pytest.fixture(scope="session")
def calibrated(lab: Path) -> bytes:
    """The store that `replay` writes of that recording."""
    store = lab.with_name("calibrated.json")
    cli.cli.main(["replay", str(lab), "--store", str(store), "--quiet"], standalone_mode=False)
    return store.read_bytes()


def still(n: int = 3000) -> list[str]:
    """Return half a minute of rest as lines of CSV."""
    values = np.random.default_rng(0).normal([0.1, 0.2, 9.8, 0, 0, 0], 0.01, (n, 6))
    rows = np.column_stack([np.arange(n) / 100, values])
    return ["t,ax,ay,az,gx,gy,gz", *(",".join(f"{v:.6f}" for v in row) for row in rows)]


def columns(lines: list[str], change: Callable[[np.ndarray], np.ndarray]) -> list[str]:
    """Return the same lines with their numbers changed."""
    rows = change(np.array([[float(v) for v in line.split(",")] for line in lines[1:]]))
    return [lines[0], *(",".join(f"{v:.6f}" for v in row) for row in rows)]


def line(row: int, text: str) -> Callable[[list[str]], list[str]]:
    return lambda lines: [*lines[: row - 1], text, *lines[row:]]


BAD = {
    "truncated": (lambda lines: [*lines[:-1], lines[-1][:9]], "cells instead of 7"),
    "missing column": (lambda lines: [lines[0].replace(",az", ""), *lines[1:]], "no column 'az'"),
    "not a number": (line(50, "0.48,0.1,nan,9.8,0,0,0"), ":50: column 'ay' holds nan"),
    "infinite": (line(50, "0.48,0.1,inf,9.8,0,0,0"), ":50: column 'ay' holds inf"),
    "backwards": (line(50, "0.11,0.1,0.2,9.8,0,0,0"), ":50: time runs backwards"),
    "repeated": (lambda lines: columns(lines, lambda rows: rows * [0, 1, 1, 1, 1, 1, 1]), "repeat"),
    "g": (lambda lines: columns(lines, lambda rows: rows / [1, *[9.80665] * 3, 1, 1, 1]), "it seems to be g"),
    "empty": (lambda lines: [], "empty"),
    "header only": (lambda lines: lines[:1], "header only"),
    "one sample": (lambda lines: lines[:2], "one accelerometer sample"),
    "all zeros": (lambda lines: columns(lines, lambda rows: rows * [1, 0, 0, 0, 0, 0, 0]), "reads zero"),
}


@pytest.mark.parametrize("command", ["replay", "apply"])
@pytest.mark.parametrize("name", BAD)
def test_bad_input_is_one_line_and_nothing_is_written(
    tmp_path: Path, run: Run, calibrated: bytes, name: str, command: str
) -> None:
    change, said = BAD[name]
    trace, store = tmp_path / "r.csv", tmp_path / "s.json"
    trace.write_text("".join(f"{text}\n" for text in change(still())))
    if command == "apply":
        store.write_bytes(calibrated)
        words = ["apply", trace, "--store", store, "--out", tmp_path / "out.csv"]
    else:
        words = ["replay", trace, "--store", store, "--json", tmp_path / "c.json"]
    before = {p: p.read_bytes() for p in tmp_path.iterdir()}
    code, out, err = run(*words)
    assert code == 2
    assert said in err
    assert err.startswith(f"stillcal: {trace}") and err.count("\n") == 1
    assert "Traceback" not in out + err
    assert {p: p.read_bytes() for p in tmp_path.iterdir()} == before


def test_degrees_for_radians_are_recognised(tmp_path: Path, run: Run, lab: Path) -> None:
    trace = tmp_path / "degrees.csv"
    header, *rows = (text.split(",") for text in lab.read_text().splitlines())
    for row in rows:
        for i in map(header.index, ("gx", "gy", "gz")):
            row[i] = row[i] and f"{math.degrees(float(row[i])):.9g}"
    trace.write_text("".join(",".join(row) + "\n" for row in (header, *rows)))
    code, _, err = run("replay", trace, "--store", tmp_path / "s.json")
    assert (code, err.count("\n")) == (2, 1)
    assert "rad/s" in err and "deg" in err
    assert not (tmp_path / "s.json").exists()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["replay", "none.csv"], "none.csv: no such file"),
        (["replay", "lab", "--format", "nonsense"], "nonsense"),
        (["replay", "lab", "--gyro", "none.csv"], "none.csv"),
        (["replay", "lab", "--config", "none.toml"], "none.toml"),
        (["replay", "lab", "--gravity", "98"], "gravity"),
        (["replay", "lab", "--json", "no/folder/c.json"], "no/folder"),
        (["replay", "lab", "--store", "no/folder/s.json"], "no/folder"),
        (["replay", "lab", "--store", "s.json", "--json", "/"], "/ cannot be written: it is a folder"),
        (["apply", "lab", "--store", "none.json", "--out", "out.csv"], "none.json: has no calibration"),
    ],
)
def test_what_cannot_be_done_is_said_in_a_line(
    tmp_path: Path, run: Run, lab: Path, monkeypatch: pytest.MonkeyPatch, words: list[str], said: str
) -> None:
    monkeypatch.chdir(tmp_path)
    code, _, err = run(*(lab if word == "lab" else word for word in words), "--quiet")
    assert code == 2
    assert said in err and "Traceback" not in err
    assert err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_a_recording_that_supports_no_calibration_says_which_attitude_is_missing(
    tmp_path: Path, run: Run
) -> None:
    trace, store, out = tmp_path / "r.csv", tmp_path / "s.json", tmp_path / "c.json"
    trace.write_text("\n".join(still()) + "\n")
    code, _, err = run("replay", trace, "--store", store, "--json", out, "--quiet")
    assert code == 3
    assert "1 distinct attitude" in err and "screen down" in err and err.count("\n") == 1
    assert not store.exists()
    assert json.loads(out.read_text())["accelerometer"] is None


def test_a_gap_of_twelve_hours_does_no_harm(tmp_path: Path, run: Run, lab: Path) -> None:
    trace, out = tmp_path / "gap.csv", tmp_path / "c.json"
    header, *rows = lab.read_text().splitlines()
    at = header.split(",").index("t")

    def later(row: str) -> str:
        cells = row.split(",")
        cells[at] = repr(float(cells[at]) + 43200 * (float(cells[at]) > 300))
        return ",".join(cells)

    trace.write_text("\n".join([header, *map(later, rows)]) + "\n")
    assert run("replay", trace, "--json", out, "--quiet") == (0, "", "")
    assert json.loads(out.read_text())["accelerometer"]["parameters"] == 9


def test_what_the_engine_warns_of_is_said(tmp_path: Path, run: Run) -> None:
    trace = tmp_path / "high.csv"
    trace.write_text("\n".join(still()) + "\n")
    events = ({"t": 2.0, "event": "location", "latitude": 50.0, "longitude": 8.0, "altitude": 9e4},) * 3
    trace.with_name("high.events.jsonl").write_text("\n".join(map(json.dumps, events)))
    _, _, err = run("replay", trace)
    assert err.count("location not used") == 1
    assert "2.0 s after the first sample: location not used: altitude 90000.0 m is not within" in err


def test_json_holds_what_is_promised(tmp_path: Path, run: Run, lab: Path) -> None:
    code, text, err = run("replay", lab, "--json", "-", "--store", tmp_path / "s.json")
    found = json.loads(text)
    assert (code, err) == (0, "")
    accel, gyro = found["accelerometer"], found["gyroscope"]
    assert found["schema"] == 1
    for part in (accel, gyro):
        assert np.shape(part["scale"]) == (3, 3) and np.shape(part["bias"]) == (3,)
    assert accel["gravity"] == pytest.approx(9.8126, abs=1e-4)
    assert accel["parameters"] == 9
    assert np.shape(accel["covariance"]) == (9, 9)
    assert accel["rms_residual"] < 0.001
    assert accel["n_rests"] == len(found["states"]) >= accel["n_states"] >= 20
    assert {"t_start", "t_end", "specific_force"} <= set(found["states"][0])
    stored = Store(tmp_path / "s.json").load()
    assert stored is not None and stored.current is not None
    np.testing.assert_array_equal(stored.current.accelerometer.scale, accel["scale"])  # type: ignore[union-attr]
    assert run("replay", lab, "--json", tmp_path / "c.json", "--quiet")[0] == 0
    again = json.loads((tmp_path / "c.json").read_text())
    assert {k: again[k] for k in ("accelerometer", "gyroscope", "states")} == {
        k: found[k] for k in ("accelerometer", "gyroscope", "states")
    }


def test_what_a_person_reads(run: Run, lab: Path, tmp_path: Path) -> None:
    code, out, _ = run("replay", lab, "--store", tmp_path / "s.json")
    assert code == 0
    for said in ("lab.csv", "9 parameters", "bias", "scale", "cross-axis", "mg before", "s.json"):
        assert said in "".join(out.splitlines())


def test_accelerometer_only(tmp_path: Path, run: Run, lab: Path) -> None:
    trace, out = tmp_path / "accel.csv", tmp_path / "c.json"
    header, *rows = lab.read_text().splitlines()
    kept = [i for i, name in enumerate(header.split(",")) if not name.startswith("g")]
    text = [",".join(row.split(",")[i] for i in kept) for row in (header, *rows)]
    trace.write_text("\n".join(row for row in text if ",," not in row) + "\n")
    assert run("replay", trace, "--json", out, "--quiet") == (0, "", "")
    found = json.loads(out.read_text())
    assert found["gyroscope"] is None
    assert found["accelerometer"]["parameters"] == 9


@pytest.mark.parametrize("suffix", [".csv", ".csv.gz"])
def test_apply_gives_scale_times_raw_less_bias_and_what_it_gives_needs_no_more(
    tmp_path: Path, run: Run, lab: Path, suffix: str
) -> None:
    store, out = tmp_path / "s.json", tmp_path / f"true{suffix}"
    run("replay", lab, "--store", store, "--json", tmp_path / "c.json", "--quiet")
    assert run("apply", lab, "--store", store, "--out", out, "--quiet") == (0, "", "")
    found, raw, corrected = json.loads((tmp_path / "c.json").read_text()), read_all(lab), read_all(out)
    for name in ("accelerometer", "gyroscope"):
        part, before, after = found[name], getattr(raw, name), getattr(corrected, name)
        np.testing.assert_array_equal(after.t, before.t)
        expected = (before.xyz - part["bias"]) @ np.array(part["scale"]).T
        np.testing.assert_allclose(after.xyz, expected, rtol=0, atol=1e-9)
    assert len(raw.events) > 0 and corrected.events == raw.events
    assert run("replay", out, "--json", tmp_path / "2.json", "--quiet")[0] == 0
    left = json.loads((tmp_path / "2.json").read_text())["accelerometer"]
    np.testing.assert_allclose(left["bias"], 0, atol=1e-3)
    np.testing.assert_allclose(left["scale"], np.eye(3), atol=2e-4)
    if suffix == ".csv.gz":
        assert gzip.decompress(out.read_bytes()).startswith(b"t,")


def test_the_recording_itself_is_never_written_over(
    tmp_path: Path, run: Run, lab: Path, calibrated: bytes
) -> None:
    before = lab.read_bytes()
    (tmp_path / "s.json").write_bytes(calibrated)
    for words in (["replay", lab, "--json", lab], ["replay", lab, "--store", lab]):
        assert run(*words, "--quiet")[0] == 2
    assert run("apply", lab, "--store", tmp_path / "s.json", "--out", lab, "--quiet")[0] == 2
    assert lab.read_bytes() == before


COMMAND = [sys.executable, "-c", "from stillcal.daemon.cli.main import main; main()"]


def test_a_process_says_the_same(tmp_path: Path) -> None:
    trace = tmp_path / "r.csv"
    trace.write_text("t,ax,ay\n0,0,0\n")
    done = subprocess.run(
        [*COMMAND, "replay", trace, "--store", tmp_path / "s.json"],
        check=False,
        capture_output=True,
        text=True,
    )
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith(f"stillcal: {trace}") and done.stderr.count("\n") == 1


INTERRUPTED = """
import os, signal
from stillcal.replay.formats import trace
whole = trace.Trace.chunks
def chunks(self, *args, **named):
    for number, chunk in enumerate(whole(self, *args, **named)):
        if number == 3:
            os.kill(os.getpid(), signal.SIGINT)
        yield chunk
trace.Trace.chunks = chunks
from stillcal.daemon.cli.main import main
main()
"""


ESGI = Path(stillcal.config.__path__[0]) / "esgi" / "dataset1.csv"


def test_six_known_faces_fix_all_twelve_parameters_from_six_rests(tmp_path: Path, run: Run) -> None:
    """The report's first phone: six rests give the bias that all 27 give; approach 2 is 0.09 m/s^2 off it."""
    header, *rows = ESGI.read_text().splitlines()
    six, store, out, whole = (tmp_path / name for name in ("six.csv", "s.json", "six.json", "all.json"))
    six.write_text("\n".join([header, *rows[:6]]) + "\n")
    common = ("--gravity", 9.81, "--quiet")
    assert run("replay", six, "--faces", "--store", store, "--json", out, *common) == (0, "", "")
    assert run("replay", ESGI, "--json", whole, *common)[0] == 0
    faces, all_rests = (json.loads(path.read_text())["accelerometer"] for path in (out, whole))
    assert faces["parameters"] == 12 and all_rests["parameters"] == 9
    np.testing.assert_allclose(faces["bias"], all_rests["bias"], atol=0.02)
    current = Store(store).load().current
    assert current.accelerometer.parameters == 12 and "six known faces" in current.acceptance.reason
    six.write_text("\n".join([header, *rows[:5]]) + "\n")
    (tmp_path / "none").mkdir()
    code, _, err = run("replay", six, "--faces", "--store", tmp_path / "none" / "s.json", *common)
    assert code == 3 and "5 of 6 faces" in err and err.count("\n") == 1
    assert list((tmp_path / "none").iterdir()) == []


def test_apply_removes_noise_and_says_how_late_it_comes(tmp_path: Path, run: Run, lab: Path) -> None:
    store, plain, smooth = tmp_path / "s.json", tmp_path / "plain.csv", tmp_path / "smooth.csv"
    assert run("replay", lab, "--store", store, "--quiet")[0] == 0
    assert run("apply", lab, "--store", store, "--out", plain, "--quiet")[0] == 0
    code, said, _ = run("apply", lab, "--store", store, "--out", smooth, "--smooth")
    raw, mean = (read_all(path).accelerometer for path in (plain, smooth))
    window = window_for(median_rate_hz(raw))
    assert code == 0 and f"mean of {window} samples" in said and "late" in said
    assert mean.t.tolist() == raw.t.tolist()
    for i in (window, 400):
        assert mean.xyz[i] == pytest.approx(raw.xyz[i - window + 1 : i + 1].mean(axis=0), abs=1e-9)


@pytest.mark.parametrize("command", ["replay", "apply"])
def test_an_interrupted_run_leaves_nothing_behind(
    tmp_path: Path, lab: Path, calibrated: bytes, command: str
) -> None:
    """The process interrupts itself, as Ctrl-C would, in the middle of the recording."""
    store = tmp_path / "s.json"
    store.write_bytes(calibrated)
    before = {p: p.read_bytes() for p in tmp_path.iterdir()}
    words = ["--json", tmp_path / "c.json"] if command == "replay" else ["--out", tmp_path / "out.csv"]
    done = subprocess.run(
        [sys.executable, "-c", INTERRUPTED, command, lab, "--store", store, *words],
        check=False,
        capture_output=True,
        text=True,
    )
    assert (done.returncode, done.stdout) == (130, "")
    assert done.stderr.strip() == "stillcal: interrupted; nothing half-written"
    assert {p: p.read_bytes() for p in tmp_path.iterdir()} == before
