"""Given simulations: shares of an effect, the relation that is true, what an answer makes of it."""

from __future__ import annotations

import json
from math import gcd
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from stillcal.replay.blind_test import answer as answering
from stillcal.replay.blind_test.cases import make_case
from stillcal.replay.blind_test.designs import WRITTEN_BACK, Design, planned
from stillcal.replay.blind_test.keys import Key, TrueEffect
from stillcal.replay.blind_test.make import read_manifest
from stillcal.replay.blind_test.marking import marked
from stillcal.replay.blind_test.scores import scored
from stillcal.replay.blind_test.simulations import cases as making
from stillcal.replay.blind_test.simulations.scaled import CONSTANTS, EFFECTS, SHARES, scaled
from stillcal.replay.commands.blind_test import challenge_group
from stillcal.replay.phone.phone import load_phone

SLOPE = TrueEffect(
    "gyro_bias_temperature", "gyro", ["x"], {"slope": [2e-4, 0.0, 0.0], "tau_s": 60.0}, 50.0, 0.0, 900.0
)


@pytest.fixture(autouse=True)
def _short(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let recordings be short: what is tested here does not depend on it."""
    monkeypatch.setattr(making, "LENGTHS_S", (250.0, 370.0))


def design(name: str, share: float = 0.5, *, reverse: bool = False, maker: str = "examiner") -> Design:
    return Design("simulated", "white", maker, (name,), 50.0, False, share=share, reverse=reverse)


def test_every_effect_meets_every_share() -> None:
    assert gcd(len(EFFECTS), len(SHARES) + 1) == 1
    designs = planned(1000, 1, ["simulated", "phone_file"], recordings=False)
    simulated = [d for d in designs if d.kind == "simulated"]
    met = {(d.names[0], d.share, d.reverse) for d in simulated}
    assert len(simulated) == 300 and len(met) == len(EFFECTS) * (len(SHARES) + 1)
    assert 0.4 < sum(d.maker == "simulator" for d in simulated) / 300 < 0.6
    assert {d.names[0] for d in designs if d.kind == "phone_file"} == set(WRITTEN_BACK)


def test_a_share_of_a_ratio_is_its_power_and_shapes_stay() -> None:
    assert scaled(SLOPE, 0.5).parameters == {"slope": [1e-4, 0.0, 0.0], "tau_s": 60.0}
    noisy = TrueEffect("noise_level", "accel", [], {"ratio": 4.0}, 9.0, 0.0, 1.0)
    assert [scaled(noisy, s).parameters["ratio"] for s in (0.0, 0.5, 2.0)] == [1.0, 2.0, 16.0]


@pytest.mark.parametrize(
    ("share", "reverse", "relation"),
    [(0.0, False, "lacking"), (0.5, False, "too_small"), (1.0, False, "agreed"), (2.0, False, "too_large"),
     (1.0, True, "superfluous")],
)  # fmt: skip
def test_the_key_states_the_relation_of_other_motion_rate_and_length(
    share: float, reverse: bool, relation: str
) -> None:
    case = make_case(design("accel_bias", share, reverse=reverse), 3, 1)
    assert case.key.relation == relation and case.simulation is not None
    real, other = case.recording.accelerometer, case.simulation.accelerometer
    assert abs(real.t[-1] - other.t[-1]) > 100.0
    assert np.median(np.diff(real.t)) / np.median(np.diff(other.t)) == pytest.approx(
        2.0 if real.t[1] > 0.03 else 0.5, rel=0.05
    )


@pytest.mark.parametrize("name", EFFECTS)
def test_every_effect_can_be_put_into_recording_and_simulation(name: str) -> None:
    maker = ("examiner", "simulator")[EFFECTS.index(name) % 2]
    with_all = make_case(design(name, 1.0, maker=maker), 3, 2)
    twice = make_case(design(name, 2.0, maker=maker), 3, 2)
    reverse = make_case(design(name, 1.0, maker=maker, reverse=True), 3, 2)
    assert with_all.simulation is not None and twice.simulation is not None
    for one, other in ((with_all.simulation, twice.simulation), (with_all.recording, reverse.recording)):
        same = len(one.accelerometer) == len(other.accelerometer) and all(
            np.array_equal(getattr(a, f), getattr(b, f))
            for a, b in ((one.accelerometer, other.accelerometer), (one.gyroscope, other.gyroscope))
            for f in ("t", "xyz", "t_arrival")
        )
        assert not same
    assert (with_all.key.effects[0].d_prime is None) == (name in CONSTANTS)


def key(relation: str) -> Key:
    return Key("simulated", "white", "examiner", variant=SLOPE.effect, effects=[SLOPE], relation=relation)


def answer(said: str | None, *, agreed: bool = False, other: bool = False) -> dict[str, Any]:
    findings = [] if said is None else [{"effect": SLOPE.effect, "sensor": "gyro", "relation": said}]
    findings += [{"effect": "accel_scale", "sensor": "accel", "relation": "lacking"}] * other
    listed = [{"effect": SLOPE.effect, "sensor": "gyro", "parameters": {}}] * agreed
    return {"schema": 2, "verdict": "identified", "findings": findings, "agreed": listed}


@pytest.mark.parametrize(
    ("relation", "given", "outcome"),
    [
        ("lacking", answer("lacking"), "right"),
        ("lacking", answer("too_small"), "wrong"),
        ("lacking", answer("superfluous"), "wrong_sign"),
        ("too_small", answer("too_large"), "wrong_sign"),
        ("too_small", answer(None), "undecided"),
        ("too_large", answer(None, agreed=True), "wrong"),
        ("agreed", answer(None, agreed=True), "right"),
        ("agreed", answer(None), "undecided"),
        ("agreed", answer("too_small"), "wrong"),
    ],
)
def test_relations_are_marked(relation: str, given: dict[str, Any], outcome: str) -> None:
    mark = marked("r1", key(relation), given)
    assert mark.relation is not None and mark.relation.outcome == outcome
    assert mark.right == (outcome == "right") and mark.relation.others == []


def test_a_bias_is_lacking_where_there_is_too_little_of_it() -> None:
    bias = TrueEffect("gyro_bias", "gyro", ["x"], {"size": [0.01, 0.0, 0.0]}, None, 0.0, 900.0)
    lacking = Key("simulated", "white", "examiner", variant="gyro_bias", effects=[bias], relation="lacking")
    said = {"effect": "gyro_bias", "sensor": "gyro", "relation": "too_small"}
    mark = marked("r1", lacking, {"verdict": "identified", "findings": [said]})
    assert mark.relation is not None and mark.relation.outcome == "right"


def test_what_is_stated_besides_is_counted() -> None:
    mark = marked("r1", key("lacking"), answer("lacking", other=True))
    assert mark.relation is not None and mark.relation.others == ["accel_scale"]


def test_only_what_can_be_told_is_required_and_a_wrong_sign_never_passes() -> None:
    right = [marked("r", key("lacking"), answer("lacking")) for _ in range(19)]
    wrong = marked("r", key("lacking"), answer("superfluous"))
    held = {line.what: line.holds for line in scored("x", [*right, wrong]).lines}
    assert held["relation right, where it can be told"] and not held["relation of the wrong sign"]
    assert not any("false alarms" in what for what in held), "recordings alone were not part of it"
    silent = [marked("r", key("agreed"), answer("too_small")) for _ in range(19)]
    held = {line.what: line.holds for line in scored("x", [*silent, wrong]).lines}
    assert not held["relation right, where it can be told"]


def test_files_of_a_given_simulation_and_of_a_phone_lie_beside_their_recordings(tmp_path: Path) -> None:
    folder = tmp_path / "recordings"
    asked = ["make", str(folder), "--keys", str(tmp_path / "keys"), "--trials", "5", "--seed", "5"]
    done = CliRunner().invoke(challenge_group, [*asked, "--stage", "simulations", "--stage", "phone-files"])
    assert done.exit_code == 0 and "making: 3 of 3" in done.output
    manifest = read_manifest(folder)
    names = list(manifest.seals)
    assert answering.answerable(folder, names, "diagnosis") == names
    assert answering.answerable(folder, names, "sparse_regression") == []
    phone = next(folder.glob(f"*{answering.PHONE}"))
    assert load_phone(phone).effects == ()
    assert (
        json.loads((folder / phone.name.replace(answering.PHONE, ".json")).read_bytes())["device"] == "phone"
    )
    fresh = folder / phone.name.replace(answering.PHONE, answering.FRESH)
    assert fresh.is_file() and not (folder / "manifest.csv").exists()


def test_a_jitter_twice_as_large_is_twice_as_large_in_the_stamps() -> None:
    """At the higher rate it was cut to the recording's size, and "agreed" was counted as wrong."""
    case = make_case(design("timestamp_jitter", 2.0), 3, 2)
    assert case.key.relation == "too_large" and case.simulation is not None
    rows = [made.accelerometer.t for made in (case.recording, case.simulation)]
    size = [float(np.diff(t).std()) for t in rows]
    assert size[1] / size[0] == pytest.approx(2.0, rel=0.1)
