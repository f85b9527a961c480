"""Every effect that a calibration can take up: adopted, applied to rests never seen, kept, refused.

The rests are made here from the formulas of docs/effects.md; tests/replay/test_adopted_terms.py goes from a
recording through the diagnosis.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from msgspec.structs import replace as replaced

from stillcal.api import Calibration, Diagnosis
from stillcal.calib_core.accelerometer.parameters import basis, inverse, names
from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.calibration.bias_curve.learn import learn_accelerometer, learn_gyroscope
from stillcal.calib_core.calibration.candidate import CalibrateSettings, fit_candidate
from stillcal.calib_core.calibration.corrections.base import Drivers
from stillcal.calib_core.calibration.corrections.catalogue import ADOPTABLE
from stillcal.calib_core.calibration.corrections.term import Term, TermParameter
from stillcal.calib_core.calibration.drift_check import QualitySettings, Verdict, check_calibration
from stillcal.calib_core.calibration.record import CalibrationRecord, Provenance
from stillcal.calib_core.calibration.rest_pool import HeldRest, Pool
from stillcal.calib_core.calibration.terms import correct, terms_uncertainty
from stillcal.calib_core.errors import NotSupported
from stillcal.calib_core.gravity import Gravity
from stillcal.calib_core.maths.rms import rms
from stillcal.calib_core.static.rest import RestState
from stillcal.calib_core.streams.beginning import Beginning
from stillcal.calib_core.streams.events import Charging
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.calib_core.temperature.charger import Charger
from stillcal.calib_core.temperature.memory import Memory
from stillcal.daemon.cli.store import store_group
from stillcal.daemon.store.document import StoreFormatError, parse, render
from stillcal.daemon.store.store import Store
from tests.support.adopted import with_terms

ACCEL, GYRO = Sensor.ACCELEROMETER, Sensor.GYROSCOPE
G = 9.81
BIAS, RATE_BIAS = np.array([0.2, -0.3, 0.1]), np.array([0.01, -0.02, 0.005])
SCALE = np.array([1.01, 0.99, 1.005])
FORCE_SD, RATE_SD, STEP_S, N = 1e-3, 1e-5, 60.0, 80
PLUGGED_S = 600.0
"""The charger is switched every so often, first at the start."""

BEGINNING = Beginning(0.0, "0123456789abcdef")

ANY = np.array([1.0, -0.8, 1.2])


@dataclass(frozen=True, slots=True, eq=False)
class Moment:
    """What drives effects: true force (n, 3), age (n,) s, temperature (n,) degC, on the charger (n,)."""

    force: Array
    age: Array
    celsius: Array
    on: Array


@dataclass(frozen=True, slots=True, eq=False)
class Case:
    """An effect: parameters as a finding has them, and its error at moments, (n, 3)."""

    parameters: dict[str, object]
    error: Callable[[Moment], Array]


def outer(a: Array, b: Array) -> Array:
    return np.asarray(a[:, None] * b)


CASES = {
    "accel_scale_temperature": Case(
        {"slope": 1e-3 * ANY}, lambda m: m.force * outer(m.celsius - 30.0, 1e-3 * ANY)
    ),
    "accel_nonlinearity": Case(
        {"quadratic": 5e-4 * ANY, "cubic": 3e-5 * ANY},
        lambda m: 5e-4 * ANY * m.force**2 + 3e-5 * ANY * m.force**3,
    ),
    "accel_charging_bias": Case({"step": 0.04 * ANY}, lambda m: outer(m.on, 0.04 * ANY)),
    "gyro_charging_bias": Case({"step": 4e-3 * ANY}, lambda m: outer(m.on, 4e-3 * ANY)),
    "accel_warmup": Case(
        {"amplitude": 0.08 * ANY, "tau_s": np.array(900.0)},
        lambda m: outer(-np.expm1(-m.age / 900.0), 0.08 * ANY),
    ),
    "gyro_warmup": Case(
        {"amplitude": 4e-3 * ANY, "tau_s": np.array(900.0)},
        lambda m: outer(-np.expm1(-m.age / 900.0), 4e-3 * ANY),
    ),
}


def sensor_of(effect: str) -> Sensor:
    return ACCEL if effect.startswith("accel") else GYRO


def finding(effect: str, **more: object) -> dict[str, object]:
    values = {k: np.asarray(v) for k, v in CASES[effect].parameters.items()}
    told = {
        k: {"value": v.tolist(), "ci95": np.stack([0.99 * v, 1.01 * v], axis=-1).tolist(), "unit": ""}
        for k, v in values.items()
    }
    where = {"t_start": 0.0, "t_end": N * STEP_S}
    return {"effect": effect, "parameters": told, "where": where, "alternatives": [], **more}


NO_STEP = {"step": {"value": [0.0, 0.0, 0.0], "unit": ""}}


def plugged() -> Charger:
    return Charger().with_events(
        Charging(t=k * PLUGGED_S, on=k % 2 == 0) for k in range(int(N * STEP_S / PLUGGED_S))
    )


@cache
def pool(effect: str, seed: int) -> Pool:
    """Return rests of a phone with one effect, or none, in all attitudes."""
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(N, 3))
    t = STEP_S * np.arange(N)
    charged = plugged().course(t + 5.0)
    m = Moment(
        G * directions / np.linalg.norm(directions, axis=1, keepdims=True),
        t + 5.0,
        30.0 + 8.0 * np.sin(t / 700.0),
        charged[:, 0] / 10.0,
    )
    error = CASES[effect].error(m) if effect else np.zeros((N, 3))
    of_force = sensor_of(effect) is ACCEL if effect else True
    force = m.force / SCALE + BIAS + FORCE_SD * rng.normal(size=(N, 3)) + of_force * error
    rate = RATE_BIAS + RATE_SD * rng.normal(size=(N, 3)) + (not of_force) * error
    sd, rate_sd = frozen(np.full(3, FORCE_SD)), frozen(np.full(3, RATE_SD))
    rests = [
        RestState(
            t[k], t[k] + 10.0, 500, frozen(force[k]), sd, sd, 0.01,
            rate=frozen(rate[k]), rate_sd=rate_sd, rate_uncertainty=rate_sd,
            temperature=float(m.celsius[k]), charged=charged[k],
        )
        for k in range(N)
    ]  # fmt: skip
    return Pool(tuple(HeldRest(rest, Gravity(G, 0.0, "given")) for rest in rests))


@cache
def record(effect: str) -> CalibrationRecord:
    """Return a calibration that knows nothing of the effect, and holds a part of it."""
    rests = pool(effect, 1)
    fitted = fit_candidate(rests, rests.held[0].gravity, N * STEP_S, CalibrateSettings()).record
    return replace(fitted, provenance=Provenance(source="day.csv", beginning=BEGINNING))


@cache
def adopted(effect: str) -> CalibrationRecord:
    return with_terms(record(effect), [finding(effect)], BEGINNING)


def left(known: CalibrationRecord, effect: str, charger: Charger, started: float | None = 0.0) -> float:
    """Return the error (rms) that a calibration leaves in rests that it never saw, SI."""
    sensor, rests = sensor_of(effect), pool(effect, 2).rests
    raw = Samples(
        sensor,
        frozen([0.5 * (r.t_start + r.t_end) for r in rests]),
        frozen([r.specific_force if sensor is ACCEL else r.rate for r in rests]),
        temperature=frozen([r.temperature for r in rests]),
    )
    done = correct(known, raw, charger=charger, started=started).xyz
    return rms(np.linalg.norm(done, axis=1) - G if sensor is ACCEL else done)


@pytest.mark.parametrize("effect", CASES)
def test_an_adopted_effect_is_corrected_on_rests_never_seen(effect: str) -> None:
    before, after = (left(known, effect, plugged()) for known in (record(effect), adopted(effect)))
    assert after < before / 5
    assert after < 3 * (FORCE_SD if sensor_of(effect) is ACCEL else 2 * RATE_SD)


@pytest.mark.parametrize("effect", ["accel_charging_bias", "gyro_charging_bias"])
def test_a_calibration_that_has_followed_later_rests_begins_anew_from_its_own(effect: str) -> None:
    """It held the bias of a moment on or off the charger that nobody kept, and was moved by the step.

    What it says of itself is that of its own rests again.
    """
    known = record(effect)
    assert known.accelerometer is not None and known.gyroscope is not None
    bias = known.accelerometer.bias + 0.03
    later = {"bias": bias, "rms_residual": 0.05, "n_rests": 3 * N, "n_states": 2 * N}
    moved = replace(
        known,
        accelerometer=replace(known.accelerometer, **later),
        gyroscope=replace(known.gyroscope, bias=known.gyroscope.bias + 2e-3),
    )
    new = with_terms(moved, [finding(effect)])
    after = left(new, effect, plugged())
    if sensor_of(effect) is ACCEL:
        assert new.accelerometer.n_rests == N >= new.accelerometer.n_states
        assert new.accelerometer.rms_residual < 2 * FORCE_SD
    assert after < 3 * (FORCE_SD if sensor_of(effect) is ACCEL else RATE_SD)


@pytest.mark.parametrize("effect", ["accel_scale_temperature", "accel_nonlinearity", "accel_charging_bias"])
def test_the_hourly_check_takes_an_adopted_effect_off_first(effect: str) -> None:
    """The scatter that the calibration had without the term is no reason to be lenient with it."""
    new = adopted(effect)
    assert new.accelerometer is not None and record(effect).accelerometer is not None
    assert new.accelerometer.rms_residual < 0.3 * record(effect).accelerometer.rms_residual
    assert check_calibration(new, pool(effect, 2), QualitySettings()).verdict is Verdict.KEEP
    plain = replace(new, terms=())
    assert check_calibration(plain, pool(effect, 2), QualitySettings()).verdict is not Verdict.KEEP


@pytest.mark.parametrize("effect", [name for name in CASES if not name.endswith("_warmup")])
def test_a_new_calibration_keeps_the_term_and_is_fitted_without_the_effect(effect: str) -> None:
    """Not of a warm-up: a daemon does not know when its sensors were switched on."""
    rests = pool(effect, 3)
    new = fit_candidate(rests, rests.held[0].gravity, 2e5, CalibrateSettings(), adopted(effect)).record
    assert new.terms == adopted(effect).terms
    assert left(new, effect, plugged()) < left(record(effect), effect, plugged()) / 5


@pytest.mark.parametrize("effect", ["gyro_charging_bias", "accel_charging_bias", "accel_nonlinearity"])
def test_what_is_learnt_at_every_check_does_not_follow_the_effect(effect: str) -> None:
    memory = Memory()
    for held in pool(effect, 2).held:
        memory = memory.with_rest(held.rest, G)
    errors = []
    for known in (record(effect), adopted(effect)):
        if sensor_of(effect) is GYRO:
            learnt = learn_gyroscope(memory, known, N * STEP_S, QualitySettings())
        else:
            learnt = learn_accelerometer(memory, known.model(ACCEL), known, N * STEP_S, QualitySettings())
        assert learnt is not None
        errors.append(rms(learnt.errors[N // 2 :]))
    assert errors[1] < errors[0] / 4


@pytest.mark.parametrize(
    "effect", ["accel_charging_bias", "gyro_charging_bias", "accel_warmup", "accel_scale_temperature"]
)
def test_an_effect_whose_driver_is_unknown_is_left_in_and_said(effect: str) -> None:
    """Before the first word of a charger, without a thermometer or a known start."""
    known, sensor = adopted(effect), sensor_of(effect)
    raw = Samples(sensor, frozen(np.arange(3.0)), frozen(np.full((3, 3), 3.0)))
    blind = correct(known, raw, charger=Charger()).xyz
    assert blind == pytest.approx(correct(replace(known, terms=()), raw).xyz)
    told = terms_uncertainty(known, sensor, Drivers(raw=np.full((1, 3), 6.0)))
    size = np.abs(np.asarray(next(iter(CASES[effect].parameters.values()))))
    assert (np.ravel(told) > 0.3 * size * (10.0 if effect.endswith("_temperature") else 1.0)).all()
    seen = Drivers(raw=raw.xyz, charged=plugged().course(raw.t), celsius=np.full(3, 30.0), age=raw.t)
    assert (terms_uncertainty(known, sensor, seen) < 0.1 * told).all()


@pytest.mark.parametrize("effect", CASES)
def test_a_store_adopts_an_effect_shows_it_and_gives_it_back(effect: str, tmp_path: Path) -> None:
    store, diagnosis = tmp_path / "store.json", tmp_path / "day.json"
    Store(store).publish(record(effect))
    skew = {"effect": "clock_skew", "parameters": {}}
    answer = {"schema": 2, "beginning": asdict(BEGINNING), "findings": [finding(effect), skew]}
    diagnosis.write_text(json.dumps(answer))
    run = CliRunner().invoke
    said = run(store_group, ["adopt-terms", str(store), str(diagnosis)])
    assert f"now corrects {effect}" in said.output
    assert "not taken up: clock_skew: a calibration has no correction for it" in said.output
    assert f"term {effect}" in run(store_group, ["show", str(store)]).output
    anew = {ACCEL: "the accelerometer's bias and scale", GYRO: "the gyroscope's bias"}[sensor_of(effect)]
    reason = f"{effect} taken up from a diagnosis; {anew} fitted anew without it"
    assert f"accepted: terms, {reason}" in run(store_group, ["show", str(store)]).output
    assert "terms from day.json" in run(store_group, ["history", str(store)]).output
    kept = Store(store).load().current
    assert (
        kept.id == adopted(effect).id and kept.terms[0].parameters.keys() == CASES[effect].parameters.keys()
    )
    assert all(p.ci95 is not None for p in kept.terms[0].parameters.values())
    assert left(kept, effect, plugged()) == pytest.approx(left(adopted(effect), effect, plugged()))
    back = Store(store).rollback().document.current
    assert back.id == record(effect).id and not back.terms


@pytest.mark.parametrize("stretched", [0.1, 3.0])
def test_an_unknown_temperature_is_as_far_off_as_those_of_the_calibration(stretched: float) -> None:
    """Five K at least: half of what charging warms a phone by."""
    known = record("accel_scale_temperature")
    states = [replace(s, temperature=30.0 + stretched * (s.temperature - 30.0)) for s in known.states]
    new = with_terms(replace(known, states=tuple(states)), [finding("accel_scale_temperature")])
    told = terms_uncertainty(new, ACCEL, Drivers(raw=new.accelerometer.bias + np.full((1, 3), 6.0)))
    slope = np.abs(CASES["accel_scale_temperature"].parameters["slope"])
    sd = max(5.0, np.std([state.temperature for state in states]))
    assert (sd > 5.0) == (stretched > 1.0)
    assert np.ravel(told) == pytest.approx(6.0 * slope * sd, rel=1e-3)


BAD = [
    ("quadratic", [1.0, 0.0, 0.0], "at most"),
    ("quadratic", [float("nan"), 0.0, 0.0], "quadratic must be finite numbers"),
    ("quadratic", [1e-4, 1e-4], "shape"),
    ("slope", [1e-4, 1e-4, 1e-4], "no parameter slope"),
]


@pytest.mark.parametrize(("name", "value", "why"), BAD)
def test_a_stored_term_that_is_out_of_range_or_garbled_is_refused(name: str, value: list, why: str) -> None:
    bad = Term(
        effect="accel_nonlinearity",
        sensor=ACCEL,
        parameters={name: TermParameter(value=np.array(value), unit="")},
    )
    with pytest.raises(ValueError, match=why):
        replace(record(""), terms=(bad,))


@pytest.mark.parametrize("end", [float("nan"), float("inf"), 1e300])
def test_a_stored_interval_that_no_sensor_has_is_refused(end: float) -> None:
    term = adopted("accel_nonlinearity").terms[0]
    quadratic = term.parameters["quadratic"]
    ends = np.where(np.arange(2) == 1, end, quadratic.ci95)
    bad = replace(term, parameters={"quadratic": replace(quadratic, ci95=ends)})
    with pytest.raises(ValueError, match="ci95 of quadratic must be numbers of"):
        replace(record(""), terms=(bad,))


def test_a_store_with_a_garbled_term_is_not_read(tmp_path: Path) -> None:
    store = Store(tmp_path / "store.json")
    store.publish(adopted("accel_warmup"))
    value = json.loads((tmp_path / "store.json").read_text())
    value["terms"][0]["parameters"]["tau_s"]["value"] = -3.0
    with pytest.raises(StoreFormatError, match="tau_s"):
        parse(json.dumps(value).encode(), trusted=True)


def test_a_store_of_the_version_before_is_read(tmp_path: Path) -> None:
    """It has neither the charger in its rests nor the speed of turns."""
    Store(tmp_path / "store.json").publish(record(""))
    document = Store(tmp_path / "store.json").load()
    value = json.loads(render(document))
    for state in value["states"]:
        del state["charging"]
    del value["gyroscope"]["turn_powers"]
    again, _ = parse(json.dumps(value).encode(), trusted=True)
    assert again.current.id == record("").id
    with pytest.raises(NotSupported, match="do not say whether the phone was on the charger"):
        with_terms(again.current, [finding("gyro_charging_bias")])


def test_what_has_nothing_to_count_from_is_refused_with_a_reason() -> None:
    daemons = replace(record("gyro_warmup"), provenance=Provenance())
    with pytest.raises(NotSupported, match="do not say how long before them the sensors were switched on"):
        with_terms(daemons, [finding("gyro_warmup")], BEGINNING)
    bare = replace(record("accel_nonlinearity"), states=())
    with pytest.raises(NotSupported, match="is without its rests"):
        with_terms(bare, [finding("accel_nonlinearity")])
    step = {"effect": "accel_bias_step", "parameters": {}}
    with pytest.raises(NotSupported, match="accel_bias_step: it is over once the phone is calibrated anew"):
        with_terms(record(""), [step])
    alike = finding("accel_nonlinearity", alternatives=[{"effect": "unknown", "indistinguishable": True}])
    with pytest.raises(NotSupported, match="accel_nonlinearity: unknown fits as well"):
        with_terms(record(""), [alike])
    simulated = finding("accel_nonlinearity", relation="superfluous")
    with pytest.raises(
        NotSupported, match="accel_nonlinearity: the simulation has it, and the recording does"
    ):
        with_terms(record(""), [simulated])


@pytest.mark.parametrize(
    ("diagnosed", "t_start", "why"),
    [
        (replace(BEGINNING, digest="another"), 0.0, r"of another recording \(day.csv\)"),
        (BEGINNING, 300.0, "only a part of the recording was diagnosed"),
        (None, 0.0, "does not say when its recording began"),
    ],
)
def test_a_warm_up_of_another_recording_of_the_same_name_is_refused(
    diagnosed: Beginning | None, t_start: float, why: str
) -> None:
    warming = finding("accel_warmup", where={"t_start": t_start, "t_end": 4800.0})
    with pytest.raises(NotSupported, match=why):
        with_terms(record("accel_warmup"), [warming], diagnosed)


def test_a_warm_up_counts_from_the_start_where_the_other_sensor_began_first() -> None:
    """It had decayed by a factor of exp(60 s / 900 s) when its own sensor began."""
    late = finding("accel_warmup", where={"t_start": 60.0, "t_end": 4800.0})
    (term,) = with_terms(record("accel_warmup"), [late], BEGINNING).terms
    amplitude = term.parameters["amplitude"]
    expected = np.exp(60.0 / 900.0) * CASES["accel_warmup"].parameters["amplitude"]
    assert amplitude.value == pytest.approx(expected)
    assert amplitude.ci95.mean(axis=-1) == pytest.approx(expected)


def test_what_a_calibration_cannot_take_up_is_said_and_the_rest_is_taken_up(tmp_path: Path) -> None:
    store, diagnosis = tmp_path / "store.json", tmp_path / "day.json"
    Store(store).publish(record("accel_charging_bias"))
    useless = finding("accel_nonlinearity", relation="superfluous", parameters={})
    found = [finding("accel_charging_bias"), finding("gyro_warmup"), useless]
    diagnosis.write_text(json.dumps({"findings": found}))
    said = CliRunner().invoke(store_group, ["adopt-terms", str(store), str(diagnosis)])
    assert said.exit_code == 0 and "now corrects accel_charging_bias\n" in said.output
    assert "not taken up: gyro_warmup: the diagnosis does not say when its recording began" in said.output
    assert "not taken up: accel_nonlinearity: the simulation has it, and the recording does" in said.output


def test_what_was_learnt_since_goes_with_the_adoption() -> None:
    """Only the sensor's own forecast goes; its rate's bias is that of the newest rest, less the effect."""
    learnt = {str(ACCEL): object(), str(GYRO): object()}
    force = with_terms(
        replace(record("accel_nonlinearity"), forecast=learnt), [finding("accel_nonlinearity")], BEGINNING
    )
    assert force.forecast.keys() == {str(GYRO)}
    rate = with_terms(
        replace(record("gyro_charging_bias"), forecast=learnt), [finding("gyro_charging_bias")], BEGINNING
    )
    assert rate.forecast.keys() == {str(ACCEL)}
    last = rate.states[-1]
    step = CASES["gyro_charging_bias"].parameters["step"]
    assert rate.gyroscope.bias == pytest.approx(last.rate - last.charging * step, rel=1e-12)


def test_python_adopts_as_the_command_does(tmp_path: Path) -> None:
    step = {"effect": "accel_bias_step", "parameters": {}}
    found = {"beginning": asdict(BEGINNING), "findings": [finding("accel_warmup"), step]}
    taken = Calibration(record("accel_warmup")).adopt(Diagnosis(found))
    assert taken.record.id == adopted("accel_warmup").id
    assert taken.left_out == {"accel_bias_step": "it is over once the phone is calibrated anew"}
    Store(tmp_path / "store.json").publish(record("accel_warmup"))
    Calibration.read(tmp_path / "store.json").adopt(Diagnosis(found)).save(tmp_path / "store.json")
    assert Store(tmp_path / "store.json").load().current.terms
    assert not Store(tmp_path / "store.json").rollback().document.current.terms


def test_a_finding_that_is_cut_short_says_what_it_lacks(tmp_path: Path) -> None:
    store, diagnosis = tmp_path / "store.json", tmp_path / "day.json"
    Store(store).publish(record("accel_warmup"))
    cut = {k: v for k, v in finding("accel_warmup").items() if k != "where"}
    diagnosis.write_text(json.dumps({"beginning": asdict(BEGINNING), "findings": [cut]}))
    said = CliRunner().invoke(store_group, ["adopt-terms", str(store), str(diagnosis)])
    assert (said.exit_code, said.output) == (2, f"stillcal: {diagnosis}: a finding lacks its where\n")


@pytest.mark.parametrize("garbled", [{"parameters": "x"}, {"alternatives": [5]}, {"where": None}])
def test_a_finding_that_is_garbled_is_refused_in_a_line(garbled: dict[str, object], tmp_path: Path) -> None:
    store, diagnosis = tmp_path / "store.json", tmp_path / "day.json"
    Store(store).publish(record("accel_warmup"))
    found = finding("accel_warmup") | garbled
    diagnosis.write_text(json.dumps({"beginning": asdict(BEGINNING), "findings": [found]}))
    said = CliRunner().invoke(store_group, ["adopt-terms", str(store), str(diagnosis)])
    why = "a finding is not as stillcal diagnose --json writes it"
    assert (said.exit_code, said.output) == (2, f"stillcal: {diagnosis}: {why}\n")


def test_a_warm_up_that_was_taken_up_is_taken_off_when_another_effect_follows() -> None:
    """The second diagnosis may be of any recording: the calibration knows its own beginning."""
    first = adopted("accel_warmup")
    again = with_terms(first, [finding("accel_charging_bias", parameters=NO_STEP)])
    assert left(again, "accel_warmup", plugged()) < 1.1 * left(first, "accel_warmup", plugged())


def test_every_effect_of_either_sensor_is_tried_here() -> None:
    others = {"accel_bias_temperature", "gyro_bias_temperature", "gyro_g_sensitivity"}  # test_terms.py
    turns = {"gyro_scale_temperature", "gyro_nonlinearity"}  # test_corrections_in_turns.py
    assert set(ADOPTABLE) == set(CASES) | others | turns


@pytest.mark.parametrize("effect", ["accel_charging_bias", "accel_warmup", "gyro_charging_bias"])
def test_the_stated_uncertainty_after_an_adoption_is_that_of_the_new_fit(effect: str) -> None:
    """It holds that of the term's own parameters, and no more the scatter that the term explains."""
    sensor, case = sensor_of(effect), CASES[effect]
    name, value = next((k, np.asarray(v)) for k, v in case.parameters.items())
    sure, settled = (BIAS, value * effect.endswith("_warmup")) if sensor is ACCEL else (RATE_BIAS, 0.0)
    errors, before = [], record(effect)
    for k in range(12):
        off = 0.01 * value * np.random.default_rng(k).normal(size=3) / 1.96
        told = finding(effect)
        told["parameters"] |= {name: {"value": (value + off).tolist(), "unit": ""}}
        told["parameters"][name]["ci95"] = np.stack(
            [value + off - 0.01 * value, value + off + 0.01 * value], -1
        )
        rests = pool(effect, 100 + k)
        fitted = fit_candidate(rests, rests.held[0].gravity, N * STEP_S, CalibrateSettings()).record
        new = with_terms(replace(fitted, provenance=before.provenance), [told], BEGINNING)
        part = new.accelerometer if sensor is ACCEL else new.gyroscope
        errors.append((part.bias - sure - settled) / part.bias_uncertainty)
    assert 0.4 < rms(np.array(errors)) < 1.2


RATE_SLOPE, BY_FORCE = 3e-4 * ANY, np.diag(1e-4 * ANY)


@pytest.mark.parametrize("effect", ["gyro_bias_temperature", "gyro_g_sensitivity"])
def test_a_bias_that_held_a_part_of_temperature_or_force_is_measured_anew(effect: str) -> None:
    """Rests lie on few sides, and are seldom warm: the mean of their rates is not the bias."""
    by_temperature = effect.endswith("temperature")
    name, value = ("slope", RATE_SLOPE) if by_temperature else ("matrix", BY_FORCE)
    rests = []
    for held in pool("", 1).held:
        warmer, up = held.rest.temperature - 30.0, SCALE * (held.rest.specific_force - BIAS)
        if up[2] > 0.0 or warmer > 4.0:
            error = warmer * RATE_SLOPE if by_temperature else BY_FORCE @ up
            rests.append(HeldRest(replaced(held.rest, rate=frozen(held.rest.rate + error)), held.gravity))
    known = fit_candidate(Pool(tuple(rests)), rests[0].gravity, N * STEP_S, CalibrateSettings()).record
    told = {"effect": effect, "parameters": {name: {"value": value.tolist(), "unit": ""}}}
    (term,), new = (after := with_terms(known, [told])).terms, after.gyroscope
    truth = RATE_BIAS + (term.reference["temperature"] - 30.0) * RATE_SLOPE if by_temperature else RATE_BIAS
    assert np.abs(new.bias - truth).max() < 2 * RATE_SD
    assert (new.bias_uncertainty < 0.1 * known.gyroscope.bias_uncertainty).all()


def test_the_rotation_of_all_axes_keeps_its_uncertainty() -> None:
    known = record("accel_charging_bias")
    rng, symmetric = np.random.default_rng(8), basis(9)
    turned = np.eye(12) - symmetric @ inverse(9)
    spread = 1e-3 * rng.normal(size=(12, 12))
    whole = replace(known.accelerometer, parameters=12, names=names(12), covariance=spread @ spread.T)
    before, after = (
        with_terms(
            replace(known, accelerometer=part), [finding("accel_charging_bias")], BEGINNING
        ).accelerometer
        for part in (known.accelerometer, whole)
    )
    assert inverse(9) @ after.covariance @ inverse(9).T == pytest.approx(before.covariance, rel=1e-6)
    assert turned @ after.covariance @ turned.T == pytest.approx(turned @ whole.covariance @ turned.T)
