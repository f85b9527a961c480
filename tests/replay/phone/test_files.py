"""What the simulated phone is told: ready phones and scenarios, populations, and files that are refused."""

from __future__ import annotations

from importlib.resources import files
from itertools import pairwise
from pathlib import Path
from typing import get_args

import msgspec
import numpy as np
import pytest

from stillcal.calib_core.streams.samples import Samples
from stillcal.replay.phone import dump_phone, load_phone, load_scenario, population, simulate
from stillcal.replay.phone.effects.registry import EFFECTS
from stillcal.replay.phone.population import FACE_RANGE, MODELS, face_deviations
from stillcal.replay.phone.scenario import Segment

PHONES = sorted(
    p.name[:-5] for p in (files("stillcal.config") / "phones").iterdir() if p.name.endswith(".toml")
)
SCENARIOS = sorted(
    p.name[:-5] for p in (files("stillcal.config") / "scenarios").iterdir() if p.name.endswith(".toml")
)
LENGTHS = {"day": (86_400.0, 1), "week": (604_800.0, 7)}


@pytest.mark.parametrize("name", PHONES)
def test_ready_phones_load_survive_a_dump_and_record_valid_samples(name: str, tmp_path: Path) -> None:
    phone = load_phone(name)
    file = tmp_path / "phone.toml"
    file.write_text(dump_phone(phone), encoding="utf-8")
    assert load_phone(file) == phone
    recording = simulate(load_scenario("starved"), phone, seed=2).whole()
    for run in (recording.accelerometer, recording.gyroscope):
        checked = Samples.checked(run.sensor, run.t, run.xyz, run.temperature, run.t_arrival)
        assert len(checked) > 20_000
        assert np.all(np.diff(run.t_arrival) >= 0.0)


@pytest.mark.parametrize("name", SCENARIOS)
def test_ready_scenarios_play(name: str) -> None:
    scenario = load_scenario(name)
    once = msgspec.structs.replace(scenario, repeat=1, duration_s=None)
    simulation = simulate(once, load_phone("ideal"), seed=1)
    pieces = simulation.plan.pieces
    assert pieces[0].t_start == 0.0
    assert pieces[-1].t_end >= simulation.plan.duration
    assert all(a.t_end == b.t_start for a, b in pairwise(pieces))
    assert len(simulation.truth.rests) >= 1
    assert (scenario.duration_s, scenario.repeat) == LENGTHS.get(name, (None, 1))


def test_claims_fill_up_from_the_settings_and_can_be_wrong() -> None:
    phone = load_phone("nexus4")
    claimed = phone.claimed()
    assert claimed["nominal_rate_hz"] == 200.0 != phone.accel.rate_hz
    assert claimed["device"] == "LG Nexus 4"
    assert claimed["accel_noise_density"] == 0.0025
    assert "gravity" not in claimed


def test_population_spreads_as_the_measured_devices_did() -> None:
    """Stisen et al. 2015, 3.1: deviations of -8.5 % to +7.5 % of g, mean 9.76 m/s^2; Table 1: rates."""
    phones = population(400, seed=1)
    affine = [(np.array(p.accel.bias), np.array(p.accel.scale)) for p in phones]
    deviations = np.concatenate([face_deviations(*a) for a in affine])
    assert FACE_RANGE[0] <= deviations.min() < -0.08
    assert 0.07 < deviations.max() <= FACE_RANGE[1]
    assert 9.81 * (1.0 + deviations.mean()) == pytest.approx(9.76, abs=0.02)
    nominal = {p.claims.nominal_rate_hz for p in phones}
    assert nominal == {m.rate_hz for m in MODELS} == {25.0, 50.0, 100.0, 125.0, 150.0, 200.0}
    share = np.mean([p.claims.device == "LG Nexus 4" for p in phones])
    assert share == pytest.approx(11 / 38, abs=0.08)


def test_population_is_the_same_whatever_its_size() -> None:
    assert population(3, seed=9) == population(5, seed=9)[:3]
    assert population(2, seed=9) != population(2, seed=10)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[accel]\nrate_hz = 0.0", "rate_hz"),
        ("[accel]\nscale = [[0, 0, 0], [0, 0, 0], [0, 0, 0]]", "invertible"),
        ("[accel]\ncutoff_hz = 60.0", "cutoff_hz"),
        ("[accel.noise]\nwhite = -1.0", "white"),
        ("[clock]\ndrop_fraction = 1.5", "drop_fraction"),
        ("[accel]\nbiass = [0, 0, 0]", "biass"),
        ('[[effect]]\nname = "magic"', "magic"),
        ("[accel", "table declaration"),
    ],
)
def test_a_bad_phone_file_is_refused_with_file_and_field(text: str, said: str, tmp_path: Path) -> None:
    file = tmp_path / "bad.toml"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(ValueError, match=said) as refusal:
        load_phone(file)
    assert "bad.toml" in str(refusal.value)


def test_an_unknown_name_is_refused_with_the_known_ones() -> None:
    with pytest.raises(ValueError, match="typical"):
        load_phone("no_such_phone")
    with pytest.raises(ValueError, match="tables"):
        load_scenario("no_such_scenario")


def test_bad_scenarios_are_refused(tmp_path: Path) -> None:
    for text, said in (
        ('[[segment]]\nactivity = "flying"', "flying"),
        ('[[segment]]\nactivity = "rest"\nduration_s = -1.0', "duration_s"),
        ('[[segment]]\nactivity = "rest"\nplace = { latitude = 91.0, longitude = 0.0 }', "latitude"),
        ("segment = []", "segment"),
        ('[[segment]]\nactivity = "rest"\nsupport = "ceiling"', "ceiling"),
        ('[[segment]]\nactivity = "table"\nsupports = { moon = 1.0 }', "moon"),
        ('[[segment]]\nactivity = "table"\nrest_s = [90.0, 5.0]', "rest_s"),
    ):
        file = tmp_path / "scenario.toml"
        file.write_text(text, encoding="utf-8")
        with pytest.raises(ValueError, match=said):
            load_scenario(file)


def test_the_guide_names_every_effect_phone_scenario_and_activity() -> None:
    guide = (Path(__file__).resolve().parents[3] / "docs" / "phone.md").read_text(encoding="utf-8")
    activities = [k.__struct_config__.tag for k in get_args(Segment)]
    missing = [n for n in [*EFFECTS, *PHONES, *SCENARIOS, *activities] if f"`{n}`" not in guide]
    assert not missing


def test_a_file_of_another_kind_is_not_called_missing(tmp_path: Path) -> None:
    recording = tmp_path / "walk.csv"
    recording.write_text("t,ax,ay,az\n")
    with pytest.raises(ValueError, match=r"walk\.csv: settings are TOML"):
        load_phone(recording)
