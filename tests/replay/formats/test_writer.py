"""Writing recordings: to the last bit, whole or not at all."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from stillcal.calib_core.arrays import frozen
from stillcal.calib_core.streams.events import Charging, Location
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.replay.formats.claims import Claims
from stillcal.replay.formats.errors import TraceError
from stillcal.replay.formats.trace import open_trace, read_all
from stillcal.replay.formats.writer import TraceWriter

VALUES = st.floats(-1e4, 1e4, allow_nan=False).map(lambda x: x + 0.0)  # no minus zero: -0.0 == 0.0 anyway


def run(sensor: Sensor, t: np.ndarray, xyz: np.ndarray, temperature: np.ndarray | None = None) -> Samples:
    return Samples(sensor, frozen(t), frozen(xyz), None if temperature is None else frozen(temperature))


def simple(n: int = 30) -> Samples:
    return run(Sensor.ACCELEROMETER, np.arange(n) / 10, np.tile([0.0, 0.0, 9.8], (n, 1)))


@settings(max_examples=40, deadline=None)
@given(data=st.data(), n=st.integers(2, 40), m=st.integers(1, 40), suffix=st.sampled_from(["csv", "csv.gz"]))
def test_what_is_written_is_read_to_the_last_bit(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject, n: int, m: int, suffix: str
) -> None:
    first = data.draw(st.floats(-1e6, 2e9))
    stamps = st.floats(first, first + 3e8).map(lambda x: x + 0.0)  # ten years at most, which one clock counts
    accelerometer = run(
        Sensor.ACCELEROMETER,
        np.sort(data.draw(hnp.arrays(np.float64, n, elements=stamps, unique=True))),
        data.draw(hnp.arrays(np.float64, (n, 3), elements=VALUES)) + np.array([0, 0, 3e4]),
        data.draw(hnp.arrays(np.float64, n, elements=VALUES)),
    )
    own = data.draw(st.booleans())
    t = (
        np.sort(data.draw(hnp.arrays(np.float64, m, elements=stamps, unique=True)))
        if own
        else accelerometer.t
    )
    gyroscope = run(Sensor.GYROSCOPE, t, data.draw(hnp.arrays(np.float64, (len(t), 3), elements=VALUES)))
    path = tmp_path_factory.getbasetemp() / f"round.{suffix}"
    with TraceWriter(path, temperature=True) as writer:
        writer.write(accelerometer, gyroscope)
    trace = open_trace(path)
    with pytest.MonkeyPatch.context() as patch:  # drawn numbers have no sensible unit
        patch.setattr("stillcal.replay.formats.trace.UnitCheck.see", lambda *_: None)
        chunks = list(trace.chunks())
    back = Samples.joined(c.accelerometer for c in chunks)
    rates = Samples.joined(c.gyroscope for c in chunks)
    np.testing.assert_array_equal(back.t, accelerometer.t)
    np.testing.assert_array_equal(back.xyz, accelerometer.xyz)
    np.testing.assert_array_equal(back.temperature, accelerometer.temperature)
    np.testing.assert_array_equal(rates.t, gyroscope.t)
    np.testing.assert_array_equal(rates.xyz, gyroscope.xyz)


def test_events_and_claims_are_written_beside(tmp_path: Path) -> None:
    events = [Charging(0.5, True), Location(1.0, 46.5, 6.6, 400.0), Location(1.5, 46.5, 6.6)]
    with TraceWriter(
        tmp_path / "r.csv", gyroscope=False, claims=Claims(device="X", accel_unit=0.1)
    ) as writer:
        writer.write(simple(), events=events)
    trace = open_trace(tmp_path / "r.csv")
    assert trace.events == events
    assert trace.claims == Claims(device="X")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["r.csv", "r.events.jsonl", "r.json"]


def test_a_new_recording_does_not_keep_old_events(tmp_path: Path) -> None:
    path = tmp_path / "r.csv"
    for events in ([Charging(0.5, True)], []):
        with TraceWriter(path, gyroscope=False) as writer:
            writer.write(simple(), events=events)
    assert open_trace(path).events == []


@pytest.mark.parametrize("notes", ["my notes", '{"device": "X", ', '{"gravity": "ten"}'])
def test_a_file_beside_that_is_no_whole_claims_is_not_written_over(tmp_path: Path, notes: str) -> None:
    (tmp_path / "r.json").write_text(notes)
    with (
        pytest.raises(TraceError, match=r"r\.json: would be replaced"),
        TraceWriter(tmp_path / "r.csv", claims=Claims(device="Y")),
    ):
        pass
    assert (tmp_path / "r.json").read_text() == notes


def test_an_error_leaves_nothing_behind_and_the_old_file_whole(tmp_path: Path) -> None:
    path = tmp_path / "r.csv"
    path.write_text("old")
    with pytest.raises(KeyError), TraceWriter(path) as writer:
        writer.write(simple(), events=[Charging(0.0, True)])
        raise KeyError
    assert [p.name for p in tmp_path.iterdir()] == ["r.csv"]
    assert path.read_text() == "old"


def test_a_folder_that_is_not_there_is_a_clear_error(tmp_path: Path) -> None:
    with pytest.raises(TraceError, match="cannot be written"), TraceWriter(tmp_path / "none" / "r.csv"):
        pass


def test_the_same_samples_give_the_same_bytes(tmp_path: Path) -> None:
    for name in ("a.csv.gz", "b.csv.gz"):
        with TraceWriter(tmp_path / name, gyroscope=False) as writer:
            writer.write(simple())
    assert (tmp_path / "a.csv.gz").read_bytes() == (tmp_path / "b.csv.gz").read_bytes()


def test_split_writing_is_whole_writing(tmp_path: Path) -> None:
    whole = simple(100)
    for name, parts in (("a.csv", [whole]), ("b.csv", [whole[:33], whole[33:34], whole[34:]])):
        with TraceWriter(tmp_path / name, gyroscope=False) as writer:
            for part in parts:
                writer.write(part)
    assert (tmp_path / "a.csv").read_bytes() == (tmp_path / "b.csv").read_bytes()
    assert len(read_all(tmp_path / "a.csv").accelerometer) == 100


@pytest.mark.parametrize("name", ["r.csv", "r.csv.gz"])
def test_a_file_that_may_not_grow_leaves_nothing_behind(tmp_path: Path, name: str) -> None:
    """A real limit (RLIMIT_FSIZE) in a process of its own: the kernel refuses the rest, also at closing."""
    script = (
        "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))\n"
        "from stillcal.daemon.cli.entry import main; main()"
    )
    command = [sys.executable, "-B", "-c", script, "convert", "sample:lab", "--out", str(tmp_path / name)]
    ran = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (ran.returncode, len(ran.stderr.splitlines())) == (2, 1) and "cannot be written" in ran.stderr
    assert list(tmp_path.iterdir()) == []


ON_A_FULL_DISK = """
import sys
import subprocess
import sys
from pathlib import Path
import numpy as np
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.replay.formats.trace import read_all
from stillcal.replay.formats.writer import TraceWriter
folder, rows = Path(sys.argv[1]), 0
for name in ("r.csv", "r.csv.gz"):
    with TraceWriter(folder / name, gyroscope=False, sparing=True) as writer:
        for second in range(100):
            if second == 3:
                with (folder / "others").open("wb", buffering=0) as others:
                    try:
                        while others.write(bytes(4096)): pass
                    except OSError: pass
            t = second + np.arange(100) / 100
            xyz = np.random.default_rng(second).normal(5.6, 0.1, (100, 3))
            writer.write(Samples.checked(Sensor.ACCELEROMETER, t, xyz))
            if writer.filled: break
    assert writer.filled and len(read_all(folder / name).accelerometer) == 100 * (second + 1)
    (folder / "others").unlink()
assert {p.name for p in folder.iterdir()} == {"r.csv", "r.csv.gz"}
print("whole")
"""


def test_a_recording_is_completed_on_a_disk_that_others_fill(tmp_path: Path) -> None:
    inside = ["unshare", "--user", "--map-root-user", "--mount"]
    if subprocess.run([*inside, "true"], check=False, capture_output=True).returncode:
        pytest.skip("no mount namespaces here")
    mount = f"mount -t tmpfs -o size=3m none {tmp_path}"
    run = f"{sys.executable} -c '{ON_A_FULL_DISK}' {tmp_path}"
    ran = subprocess.run(
        [*inside, "sh", "-c", f"{mount} && {run}"], capture_output=True, text=True, check=False
    )
    assert ran.stdout == "whole\n", ran.stderr
