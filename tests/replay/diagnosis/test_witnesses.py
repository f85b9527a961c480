"""Other sensors on the same body: turned, late, on a clock of their own, or on another body."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stillcal.calib_core.errors import NotSupported, UserError
from stillcal.daemon.cli.exits import BAD_INPUT
from stillcal.replay.diagnosis.pair.witnesses import judge_with_witnesses
from stillcal.replay.diagnosis.words.summary import summary
from stillcal.replay.formats.trace import Recording
from tests.support.diagnosis.one_body import Body, sensor, spun

OBLIQUE = Rotation.from_rotvec(np.radians(37.0) * np.array([1.0, 2.0, -1.0]) / np.sqrt(6.0))


@pytest.mark.slow
def test_how_a_witness_is_turned_and_what_its_clock_says_is_told_and_no_finding() -> None:
    witness = sensor(2, "other.csv", turned=OBLIQUE, late=0.13, ppm=200.0)
    said = judge_with_witnesses(sensor(1), [witness]).answer
    assert said["verdict"] == "match" and said["findings"] == []
    (told,) = said["witnesses"]
    for one, truth in (
        (told["mounting"]["angle"], 37.0),
        (told["clock"]["delay"], 0.13 + 240.0 * 2e-4),
        (told["clock"]["rate"], 2e-4),
    ):
        low, high = one["ci95"]
        assert low <= truth <= high
    assert any("other.csv is turned by 3" in line for line in summary(said))


@pytest.mark.slow
@pytest.mark.parametrize("owner", [0, 1])
def test_what_one_of_three_sensors_shows_is_told_as_its_own(owner: int) -> None:
    drift, brief = np.array([6e-3, 0.0, -3e-3]), 240.0
    own, other = (drift if owner == k else None for k in range(2))
    witnesses = [
        sensor(2, "one.csv", turned=OBLIQUE, late=0.13, ppm=200.0, drift=other, length=brief),
        sensor(3, "two.csv", turned=OBLIQUE.inv(), length=brief),
    ]
    said = judge_with_witnesses(sensor(1, drift=own, length=brief), witnesses).answer
    found, notes = said["findings"], [one["findings"] for one in said["witnesses"]]
    if owner == 0:
        assert found and {f["sensor"] for f in found} == {"gyro"} and notes == [[], []]
        assert all(f["owners"]["real.csv"] > 0.95 and f["probability"] > 0.95 for f in found)
    else:
        assert (said["verdict"], found, notes[1]) == ("match", [], [])
        assert {f["sensor"] for f in notes[0]} == {"gyro"}
        assert any("it is one.csv's" in line for line in summary(said))


@pytest.mark.slow
def test_a_witness_without_a_gyroscope_has_no_vote_on_one() -> None:
    """Five rests, which are too few for either gyroscope to show by itself which one drifts."""
    drift, brief = np.array([6e-3, 0.0, -3e-3]), 120.0
    one = sensor(2, "one.csv", turned=OBLIQUE, drift=drift, length=brief)
    two = replace(sensor(3, "two.csv", length=brief), gyroscope=None)
    said = judge_with_witnesses(sensor(1, length=brief), [one, two]).answer
    assert said["findings"]
    for found in said["findings"]:
        assert found["owners"]["two.csv"] == 0.0 and found["probability"] < 0.95
        assert "real.csv or one.csv" in found["statement"]


def test_a_witness_on_another_body_is_refused() -> None:
    with pytest.raises(UserError, match=r"^other\.csv: was not on the same body as real\.csv") as refusal:
        judge_with_witnesses(sensor(1), [sensor(2, "other.csv", body=Body(5))])
    assert not isinstance(refusal.value, NotSupported)


def test_a_sensor_of_a_witness_that_ends_early_is_named() -> None:
    one, other = (sensor(k, f"{k}.csv", length=60.0) for k in (2, 3))
    assert other.gyroscope is not None
    other = replace(other, gyroscope=other.gyroscope[:500])
    until = other.gyroscope.t[-1]
    with pytest.raises(UserError, match=rf"3\.csv: recorded .* and the gyroscope from 0 to {until:.6g} s;"):
        judge_with_witnesses(sensor(1, length=60.0), [one, other])


def test_a_witness_whose_mounting_is_not_shown_is_refused_as_too_little_data() -> None:
    vertical = np.array([0.0, 0.0, 1.0])
    with pytest.raises(NotSupported, match=r"how 2\.csv is mounted is not shown"):
        judge_with_witnesses(spun(vertical, 1), [spun(vertical, 2)])


def test_the_command_refuses_another_body_in_one_line(tmp_path: Path) -> None:
    for name, seed in (("real.csv", 1), ("other.csv", 5)):
        _write(tmp_path / name, sensor(seed, body=Body(seed), length=120.0))
    program = "from stillcal.daemon.cli.entry import main; main()"
    words = ["diagnose", str(tmp_path / "real.csv"), "--witness", str(tmp_path / "other.csv")]
    done = subprocess.run(
        [sys.executable, "-c", program, *words], capture_output=True, text=True, check=False
    )
    assert done.returncode == BAD_INPUT
    assert done.stderr.strip().splitlines()[-1].startswith("stillcal: other.csv: was not on the same body")


def _write(path: Path, one: Recording) -> None:
    assert one.gyroscope is not None
    table = np.column_stack([one.accelerometer.t, one.accelerometer.xyz, one.gyroscope.xyz])
    np.savetxt(path, table, "%.7g", ",", header="t,ax,ay,az,gx,gy,gz", comments="")
