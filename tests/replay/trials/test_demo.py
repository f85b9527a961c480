"""What `make run` runs, and `stillcal simulate`."""

from __future__ import annotations

import json
import os
import signal
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st

from stillcal.daemon.cli.main import cli
from stillcal.replay.commands.simulate import truth_of
from stillcal.replay.phone import load_scenario, simulate
from stillcal.replay.trials.demo import live as demo_live
from stillcal.replay.trials.demo import tour as shown
from stillcal.replay.trials.demo.tour import demo, force_error, phone_at
from tests.support.forked import Forked

LAB = ["--scenario", "lab"]


def test_a_daemon_lives_with_the_simulated_phone_and_the_real_ones_follow(tmp_path: Path) -> None:
    out = tmp_path / "out"
    result = CliRunner().invoke(demo, ["--out", str(out), *LAB])
    assert result.exit_code == 0, result.output
    store = json.loads((out / "live.json").read_text())
    true = truth_of(simulate(load_scenario("lab"), phone_at(50.0), 1))
    bias_error = np.array(store["accelerometer"]["bias"]) - true["accelerometer"]["bias"]
    # Single rests of 20 s stand within 0.1 mg (150 ug/sqrt(Hz), 0.06 mg of wander); five times that.
    assert np.abs(bias_error).max() < 5 * 0.1e-3 * 9.81
    for told in (
        "calibrated: the first calibration",
        "beside the truth",
        "sensors on for",
        "its state saved",
    ):
        assert told in result.output
    assert result.output.count("rows of a rest table") == 3
    assert " stopped: state saved" in (out / "live.log").read_text().splitlines()[-1]
    assert ("Figure: " in result.output) == (out / "lab.png").exists()


def test_without_matplotlib_it_says_how_to_have_the_figure(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    assert ".[report]" in shown._drawn(None, None, tmp_path / "day.png")  # type: ignore[arg-type]
    assert not list(tmp_path.iterdir())


def test_a_scenario_that_does_not_exist_is_refused(tmp_path: Path) -> None:
    result = CliRunner().invoke(demo, ["--out", str(tmp_path / "out"), "--scenario", "nowhere"])
    assert result.exit_code == 2 and "nowhere" in result.output
    assert not list(tmp_path.iterdir())


def started(out: Path) -> Forked:
    """Start the demo and wait until its daemon has spoken of the phone."""
    process = Forked(["--out", out], demo, together=True)
    for line in process.stdout:
        if "gravity" in line:
            return process
    raise AssertionError("the demo ended before its daemon spoke")


def daemon_of(process: Forked) -> int:
    (child,) = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
    return int(child)


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_interrupted_it_leaves_no_daemon_behind(tmp_path: Path, number: signal.Signals) -> None:
    with started(tmp_path / "out") as process:
        daemon = daemon_of(process)
        process.send_signal(number)
        assert process.wait(30) == 1
    with pytest.raises(ProcessLookupError):
        os.kill(daemon, 0)
    assert (tmp_path / "out" / "live.state").exists()


def test_a_daemon_that_dies_is_told_with_its_log(tmp_path: Path) -> None:
    with started(tmp_path / "out") as process:
        os.kill(daemon_of(process), signal.SIGKILL)
        said, _ = process.said()
    assert process.returncode == 1
    assert f"the daemon ended with code -9: see {tmp_path / 'out' / 'live.log'}" in said


def test_an_older_run_is_forgotten_and_nothing_else(tmp_path: Path) -> None:
    for name in ("live.json", "live.json.last-good", "live.state", "live.log", "mine.json"):
        (tmp_path / name).touch()
    demo_live.Files.in_folder(tmp_path)
    assert [p.name for p in tmp_path.iterdir()] == ["mine.json"]


@pytest.mark.parametrize(
    ("event", "told"),
    [
        ("charging: plugged in t=4596.97 occasion=charging", " 1:16  charging: plugged in"),
        (
            "watch: sensing mode: continuous t=-0.0001",
            " 0:00  watch: sensing mode: continuous",
        ),
        ("ready", " 0:00  ready"),
    ],
)
def test_events_are_told_by_the_phones_clock(event: str, told: str) -> None:
    assert shown._told(event) == told


@given(st.integers(0, 2**32 - 1))
def test_the_error_over_attitudes_is_what_averaging_over_attitudes_gives(seed: int) -> None:
    rng = np.random.default_rng(seed)
    found, true = (model(rng) for _ in range(2))
    # Plus and minus each axis average to the sphere's second moments, exactly.
    x = 9.8 * np.vstack([np.eye(3), -np.eye(3)])
    raw = x @ np.linalg.inv(true["scale"]).T + true["bias"]
    errors = (raw - found["bias"]) @ found["scale"].T - x
    assert force_error(found, true, 9.8) == pytest.approx(np.sqrt(np.mean(np.sum(errors**2, axis=1))))
    assert force_error(true, true) == pytest.approx(0.0, abs=1e-12)


def model(rng: np.random.Generator) -> dict[str, Any]:
    return {"scale": np.eye(3) + rng.uniform(-0.1, 0.1, (3, 3)), "bias": rng.uniform(-1, 1, 3)}


def test_the_same_seed_writes_the_same_recording(tmp_path: Path) -> None:
    for name in ("a", "b"):
        out = str(tmp_path / f"{name}.csv")
        assert CliRunner().invoke(cli, ["simulate", "lab", "--out", out, "--seed", "4"]).exit_code == 0
    assert (tmp_path / "a.csv").read_bytes() == (tmp_path / "b.csv").read_bytes()
    assert json.loads((tmp_path / "a.json").read_text())["nominal_rate_hz"] == 100


@pytest.mark.parametrize(
    ("arguments", "said"),
    [(["nowhere"], "nowhere"), (["lab", "--phone", "no-such-phone"], "no-such-phone")],
)
def test_what_cannot_be_simulated_is_refused_by_name(tmp_path: Path, arguments: list[str], said: str) -> None:
    out = tmp_path / "x.csv"
    result = CliRunner().invoke(cli, ["simulate", *arguments, "--out", str(out)])
    assert result.exit_code == 2 and said in result.output
    assert not list(tmp_path.iterdir())
