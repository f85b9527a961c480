"""The slow search on simple phones of known truth: silence on nulls, names, parameters, honesty."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import msgspec
import numpy as np
import pytest

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.codec import plain
from stillcal.calib_core.diagnosis.effects.by_force import distinct
from stillcal.calib_core.diagnosis.effects.catalogue import effects_of
from stillcal.calib_core.diagnosis.effects.timed import DRIFT_PENALTY
from stillcal.calib_core.diagnosis.effects.warmup import LatentHeat
from stillcal.calib_core.diagnosis.inference.cross_validation import HeldOut
from stillcal.calib_core.diagnosis.inference.likelihood import (
    fit_hypothesis,
    log_sum,
    log_terms,
    null_log_likelihood,
    reduce_residuals,
)
from stillcal.calib_core.diagnosis.inference.score import score
from stillcal.calib_core.diagnosis.model import settings as thresholds
from stillcal.calib_core.diagnosis.model.hypothesis import SensorResiduals
from stillcal.calib_core.diagnosis.model.moments import History, Moments
from stillcal.calib_core.diagnosis.model.records import Evidence, Finding, Parameter, Where
from stillcal.calib_core.diagnosis.model.sensor_residuals import by_sensor
from stillcal.calib_core.diagnosis.slow import search, standing, statement
from stillcal.calib_core.diagnosis.slow.estimate import Estimate, estimate, tried
from stillcal.calib_core.diagnosis.slow.findings import not_unknown_twice
from stillcal.calib_core.diagnosis.slow.search import Scored, Step, adequate, forward, ranking
from stillcal.calib_core.diagnosis.slow.standing import _to_and_fro, each_driver_once
from stillcal.calib_core.diagnosis.slow.statement import Stated
from tests.support.diagnosis import nulls
from tests.support.diagnosis.said import slow_findings


def day_of(seed: int, rests: int = 20, seconds: int = 3600) -> tuple[np.random.Generator, nulls.Day]:
    """Draw days until one has enough rests in many attitudes, with the charger in and out."""
    rng = np.random.default_rng(seed)
    day = nulls.schedule(rng, seconds)
    while (
        day.rest.max() < rests
        or len(np.unique(np.diff(day.charging))) < 3
        or distinct(day.up[day.rest >= 0][::60]) < 10
    ):
        day = nulls.schedule(rng, seconds)
    return rng, day


SECONDS = 2400
"""Of days on which nothing is wrong, or what is put in is large; else they have an hour."""


@cache
def found(
    sensor: str, seed: int, family: str = "white", seconds: int = 3600, **kind: object
) -> list[Finding]:
    rng, day = day_of(seed, seconds=seconds)
    driver = {"temperature": day.temperature, "charging": day.charging, "warmup": 1 - np.exp(-day.t / 300.0)}
    effect = {k: np.outer(driver[v[0]], v[1]) for k, v in kind.items() if k.endswith("_error")}  # type: ignore[index]
    flags = {k: v for k, v in kind.items() if not k.endswith("_error")}
    bins = nulls.bins_of(rng, day, family, **effect, **flags)
    return slow_findings(next(s for s in by_sensor(bins, nulls.G) if s.sensor == sensor))


@pytest.mark.slow
@pytest.mark.parametrize("family", ["white", "flicker", "gm300", "walk_strong", "mixture"])
def test_silent_where_nothing_is_wrong(family: str) -> None:
    """Of days drawn anew, one sensor in e^4 = 55 may pass the score; its finding is weighed once more."""
    rng = np.random.default_rng([11, nulls.FAMILIES.index(family) % 2])
    bins = nulls.bins_of(rng, nulls.schedule(rng, SECONDS), family)
    for residuals in by_sensor(bins, nulls.G):
        ranked = ranking(residuals, effects_of(residuals.sensor))
        assert not ranked or ranked[0].score < thresholds.SCORE


def linear(finding: Finding) -> Iterator[tuple[float, float, float]]:
    parameter = next(iter(finding.parameters.values()))
    for value, (low, high) in zip(parameter.value, parameter.ci95, strict=True):  # type: ignore[arg-type]
        yield value, low, high


@pytest.mark.slow
@pytest.mark.parametrize(
    ("sensor", "driver", "size", "effect"),
    [
        ("accel", "temperature", (0.004, 0.0, -0.003), "accel_bias_temperature"),
        ("gyro", "temperature", (0.0, 2e-4, 0.0), "gyro_bias_temperature"),
        ("accel", "charging", (0.0, 0.02, 0.01), "accel_charging_bias"),
        ("gyro", "charging", (4e-4, 0.0, 0.0), "gyro_charging_bias"),
        ("accel", "warmup", (0.05, 0.0, 0.03), "accel_warmup"),
    ],
)
def test_named_with_axes_and_parameters(
    sensor: str, driver: str, size: tuple[float, ...], effect: str
) -> None:
    findings = found(sensor, 5, "gm50", **{f"{sensor}_error": (driver, size)})
    assert [f.effect for f in findings] == [effect]
    first = findings[0]
    assert first.axes == [a for a, s in zip("xyz", size, strict=True) if s]
    for (value, low, high), truth in zip(linear(first), size, strict=True):
        width = (high - low) / 2
        assert low < value < high
        assert abs(value - truth) < 1.6 * width
    assert first.evidence.heldout_log_score_gain > 0.0
    assert (first.evidence.log_bayes_factor or 0.0) > 7.0


@pytest.mark.slow
def test_heat_is_found_without_a_thermometer() -> None:
    warm = ("temperature", (0.01, 0.0, -0.008))
    findings = found("accel", 5, "gm50", SECONDS, accel_error=warm, thermometer=False)
    assert findings[0].effect == "thermal_latent"
    assert set(findings[0].axes) == {"x", "z"}
    assert "tau_s" in findings[0].parameters


def test_heat_of_use_needs_use_that_shows() -> None:
    """A phone that is handled for three seconds a rest gets no warmer; it settles after its start."""
    windows = np.arange(2400.0)
    t = np.arange(5.0, 2400.0, 10.0)
    for period, offered in ((400, False), (6, True)):
        history = History((0.0, 2400.0), np.stack([windows, (windows % period < 3).astype(float)], axis=1))
        assert bool(LatentHeat("accel").points(Moments(t, np.full(t.size, 10.0), history))) == offered


def test_a_thermometer_that_does_nothing_raises_no_alarm() -> None:
    assert found("accel", 8, "flicker", SECONDS) == []


def test_a_finding_encodes_to_the_documented_structure() -> None:
    finding = found("gyro", 5, "gm50", gyro_error=("charging", (4e-4, 0.0, 0.0)))[0]
    table = msgspec.json.decode(msgspec.json.encode(plain(finding)))
    assert set(table) == {
        "effect", "sensor", "axes", "where", "parameters", "evidence", "alternatives", "statement",
        "departure", "remark", "echoes",
    }  # fmt: skip
    assert set(table["where"]) == {"t_start", "t_end", "band_hz", "driver"}
    assert table["parameters"]["step"]["unit"] == "rad/s"
    assert set(table["evidence"]) >= {
        "log_bayes_factor",
        "heldout_rmse_before",
        "heldout_log_score_gain",
        "folds",
    }


def test_score_is_the_tail_of_f() -> None:
    """With one parameter and many degrees of freedom, a gain of z^2/2 scores as a normal deviate z."""
    assert score(4.0**2 / 2, 1, 1e7, 1) == pytest.approx(-np.log10(6.334e-5), rel=1e-3)
    assert score(8.0, 1, 1e7, 100) == pytest.approx(score(8.0, 1, 1e7, 1) - 2.0)


def test_shapes_find_the_wander_that_was_put_in() -> None:
    rng, day = day_of(4)

    def walking(family: str) -> float:
        """Return the gyroscope's walk, a variance rate, as a part of what `walk_strong` has."""
        residuals = by_sensor(nulls.bins_of(rng, day, family), nulls.G)[1]
        reduced = reduce_residuals(residuals)
        assert np.isfinite(null_log_likelihood(reduced))
        terms = log_terms(reduced[0], reduced[0].left)
        return float(np.exp(terms - log_sum(terms)) @ reduced[0].walk) / (0.05 * nulls.WHITE["gyro"]) ** 2

    assert walking("white") < 0.1
    assert 1 / 3 < walking("walk_strong") < 3.0


def test_a_drift_beside_a_walk_is_as_uncertain_as_the_walk_makes_it() -> None:
    """36 rates of which 95 % are to be within their intervals; 29 and fewer are by chance once in 1,000."""
    drift = next(e for e in effects_of("gyro") if e.name == "gyro_bias_drift")
    true, inside = np.array([3e-7, -2e-7, 0.0]), 0
    for trial in range(12):
        rng = np.random.default_rng([5, trial])
        day = nulls.schedule(rng, 1800)
        ramp = (day.t - 900.0)[:, None] * true
        residuals = by_sensor(nulls.bins_of(rng, day, "walk_strong", gyro_error=ramp), nulls.G)[1]
        found = estimate(residuals, residuals.hypotheses(drift)[0], [])
        inside += int((np.abs(found.value - true) < 1.96 * found.sigma).sum())
    assert inside >= 30


def test_what_has_no_name_is_said_once_for_each_driver() -> None:
    def stated(effect: str, driver: str, evidence: float, period: float | None = None) -> Stated:
        where = Where(0.0, 1000.0, (0.0, 0.1), driver)
        sizes = {} if period is None else {"period_s": Parameter(period, None, "s")}
        return Stated(Finding(effect, "gyro", ["x"], where, sizes, Evidence(evidence), [], ""))

    weak, strong = stated("unknown", "charging", 8.0), stated("unknown", "charging", 20.0)
    others = [stated("unknown", "temperature", 5.0), stated("gyro_bias_step", "charging", 4.0)]
    assert each_driver_once([weak, *others, strong]) == [*others, strong]
    sine, overtones = stated("unknown", "a period", 9.0, 55.0), stated("unknown", "a sawtooth", 7.0, 54.5)
    assert each_driver_once([overtones, sine]) == [sine]
    apart = stated("unknown", "a sawtooth", 7.0, 50.0)
    assert each_driver_once([apart, sine]) == [apart, sine]


def test_wander_without_a_name_is_not_told_beside_structure_without_one() -> None:
    """What two levels in time leave is no second cause; a walk is told by its name."""
    where = Where(0.0, 1.0, (0.0, 0.05), "nothing")

    def made(effect: str) -> Finding:
        return Finding(effect, "gyro", ["x"], where, {}, Evidence(9.0), [], "")

    unknown, walk, step = made("unknown"), made("gyro_bias_random_walk"), made("gyro_bias_step")
    assert not_unknown_twice([Stated(step), Stated(unknown)], [unknown]) == []
    assert not_unknown_twice([Stated(unknown)], [walk]) == [walk]
    assert not_unknown_twice([Stated(step)], [unknown]) == [unknown]


def test_what_predicts_a_bias_that_wanders_is_judged_in_one_noise() -> None:
    """The walk makes most of the misses, alike in neighbours: with the effect they are 1.14 times as large.

    By their rms it did not predict, and lost its name.
    """
    rng = np.random.default_rng(8)
    while (day := nulls.schedule(rng, 1200)).rest.max() < 12:
        pass
    day = replace(day, charging=((day.t // 170) % 2).astype(float))
    walk = {"accel": nulls.Wander(), "gyro": nulls.Wander(walk=4e-5)}
    error = np.outer(day.charging, [0.0, 3e-4, 3e-4])
    bins = nulls.bins_of(rng, day, walk, gyro_error=error, thermometer=False)
    made = slow_findings(next(s for s in by_sensor(bins, nulls.G) if s.sensor == "gyro"))
    (charging,) = (f.evidence for f in made if f.effect == "gyro_charging_bias")
    assert (charging.heldout_rmse_after or 0.0) > 1.1 * (charging.heldout_rmse_before or 0.0)
    assert (charging.heldout_gain_in_one_noise or 0.0) > 10.0


def test_what_misses_in_the_noise_that_comes_with_it_is_contradicted() -> None:
    said = Evidence(9.0, 1.0, 1.2, 5.0)
    assert said.contradicted, "noise that does not wander: the rms of the misses says it"
    assert not replace(said, heldout_gain_in_one_noise=3.0).contradicted
    assert replace(said, heldout_gain_in_one_noise=-0.1).contradicted
    assert replace(said, heldout_log_score_gain=-0.1, heldout_gain_in_one_noise=3.0).contradicted


@pytest.mark.slow
def test_a_name_whose_sizes_may_all_be_nothing_is_taken_off() -> None:
    """A gain that changes at a moment was told as a step of the bias by z -2.2 +- 2.7 mg, without a doubt."""
    rng = np.random.default_rng(2)
    day = nulls.schedule(rng, 1500)
    error = np.zeros((day.t.size, 3))
    error[:, 2] = 0.006 * nulls.G * day.up[:, 2] * (day.t > 700.0)
    made = slow_findings(by_sensor(nulls.bins_of(rng, day, "white", accel_error=error), nulls.G)[0])
    assert [f.effect for f in made] == ["unknown"]
    assert ("accel_bias_step", True) in [(a.effect, a.indistinguishable) for a in made[0].alternatives]


def test_latent_heat_has_one_size_wherever_it_is_asked_for() -> None:
    """What is taken off a turn is the part of the curve there, also where the heat stands still in it."""
    t = np.arange(0.5, 3600.0)
    switches = np.array([[0.0, 0.0], [600.0, 1.0], [1800.0, 0.0]])
    history = History((0.0, 3600.0), np.column_stack([t, np.zeros(t.size)]), switches)
    grid = {"tau_s": 300.0, "plug": 1.0, "use": 0.0, "start": 0.0}
    effect, whole = LatentHeat("gyro"), Moments(t, np.zeros(t.size), history)
    curve = effect.curve(whole, grid)
    assert np.ptp(curve) == pytest.approx(1.0, rel=1e-3)
    for rows in (slice(0, 100), slice(700, 710), slice(2000, 2003)):
        np.testing.assert_array_equal(effect.curve(whole.during(rows), grid), curve[rows])


def test_two_steps_of_one_bias_keep_their_name() -> None:
    rng = np.random.default_rng(11)
    day = nulls.schedule(rng, 900)
    error = np.outer(day.t > 250.0, (5e-4, 0.0, 0.0)) + np.outer(day.t > 600.0, (0.0, 6e-4, 0.0))
    residuals = by_sensor(nulls.bins_of(rng, day, "white", gyro_error=error), nulls.G)[1]
    steps = adequate(forward(residuals, [e for e in effects_of("gyro") if e.name == "gyro_bias_step"]))
    both = [s.winner.hypothesis for s in steps]
    assert [h.effect.name for h in both] == ["gyro_bias_step"] * 2
    assert sorted(h.grid["t_start"] for h in both) == pytest.approx([250.0, 600.0], abs=10.0)
    assert [s.winner.hypothesis.effect.name for s in adequate([*steps, steps[0]])] == ["unknown"] * 3


def test_a_second_step_that_may_undo_the_first_takes_the_name_of_both() -> None:
    rng, day = day_of(3)
    residuals = by_sensor(nulls.bins_of(rng, day, "white"), nulls.G)[1]
    effect = next(e for e in effects_of("gyro") if e.name == "gyro_bias_step")
    own = residuals.hypothesis(effect, {"t_start": 500.0})

    def of(*value: float) -> Estimate:
        return Estimate(own, np.array(value), 1e-8 * np.eye(3), {}, 50.0)

    up = of(2e-3, 0.0, 0.0)
    assert _to_and_fro([up, of(-2e-3, 1e-4, 0.0)]) == "gyro_bias_step"
    assert _to_and_fro([up, of(-2e-3, 1e-3, 0.0)]) == "" == _to_and_fro([up])


@pytest.mark.parametrize("sensor", ["accel", "gyro"])
def test_what_a_heated_chamber_shows_keeps_its_name_beside_a_drift_that_explains_it_as_well(
    sensor: str,
) -> None:
    """As the temperature rises steadily, folds may prefer the drift by a tenth of a nat: it was unknown."""
    rng, day = day_of(1, seconds=SECONDS)
    day = replace(day, temperature=np.linspace(-5.0, 50.0, day.t.size))
    error = np.outer(day.temperature - 20.0, [1e-4, 2e-4, -1e-4]) * (20.0 if sensor == "accel" else 1.0)
    effect = {f"{sensor}_error": error}
    residuals = by_sensor(nulls.bins_of(rng, day, "white", **effect), nulls.G)  # type: ignore[arg-type]
    (one,) = slow_findings(next(r for r in residuals if r.sensor == sensor))
    assert one.effect == f"{sensor}_bias_temperature"
    assert [a.effect for a in one.alternatives if a.indistinguishable] == [f"{sensor}_bias_drift"]


def test_a_drift_gives_away_in_folds_what_it_does_in_the_search_as_a_rival_only() -> None:
    """Where it was chosen it has paid that already: one of d' 20 lost its name to a settling in all folds."""
    rng, day = day_of(1, seconds=SECONDS)
    residuals = by_sensor(nulls.bins_of(rng, day, "white"), nulls.G)[1]

    def held(name: str, nats: float) -> tuple[Scored, HeldOut]:
        effect = next(e for e in effects_of("gyro") if e.name == name)
        own = residuals.hypotheses(effect)[0]
        training = (nats + float(np.log(tried(residuals, own))),) * 5
        fit = fit_hypothesis(reduce_residuals(residuals, [own]), 0)
        return Scored(own, fit, 50.0, 50.0), HeldOut(nats, np.zeros(0), np.zeros(0), training, ())

    slope = held("gyro_bias_temperature", 50.0)
    toll = np.log(10.0) * DRIFT_PENALTY
    for ahead, first in ((toll - 1.0, 5), (toll + 1.0, 0)):
        assert statement._first_in(residuals, slope, [held("gyro_bias_drift", 50.0 + ahead)]) == first
    for ahead, first in ((1.0, 5), (-1.0, 0)):
        assert statement._first_in(residuals, held("gyro_bias_drift", 50.0 + ahead), [slope]) == first


def two_steps(seed: int) -> tuple[SensorResiduals, list[Array]]:
    """Return the accelerometer's residuals of 40 minutes with two steps of 50 mm/s^2, and these."""
    rng, day = day_of(seed, seconds=SECONDS)
    sizes = [0.05 * v / np.linalg.norm(v) for v in np.random.default_rng(seed).normal(size=(2, 3))]
    error = np.outer(day.t > 0.3 * SECONDS, sizes[0]) + np.outer(day.t > 0.7 * SECONDS, sizes[1])
    return by_sensor(nulls.bins_of(rng, day, "white", accel_error=error), nulls.G)[0], sizes


def sizes_in_time(found: Sequence[Finding]) -> Array:
    """Return the sizes (n, 3) of steps in the order of their moments."""
    ordered = sorted(found, key=lambda f: f.where.t_start)
    return np.array([f.parameters["step"].value for f in ordered])


@pytest.mark.parametrize("seed", [2, pytest.param(4, marks=pytest.mark.slow)])
def test_two_steps_are_found_though_a_curve_without_a_name_explains_more_than_either(seed: int) -> None:
    """Either is sought again beside the other: the best moment of one alone is between the two."""
    residuals, sizes = two_steps(seed)
    found = slow_findings(residuals)
    assert [f.effect for f in found] == ["accel_bias_step"] * 2
    assert sizes_in_time(found) == pytest.approx(np.array(sizes), abs=2e-3)


@pytest.mark.slow
def test_a_second_effect_that_folds_call_otherwise_stays_without_its_name(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Left out, it would spoil the size of the first: only its name is not told."""
    residuals, sizes = two_steps(2)

    def chosen(_: object, own: tuple[search.Scored, object], rivals: object) -> int:
        return statement.FOLDS if own[0].hypothesis.grid["t_start"] > 0.5 * SECONDS else 1

    monkeypatch.setattr(statement, "_first_in", chosen)
    found = slow_findings(residuals)
    assert sorted(f.effect for f in found) == ["accel_bias_step", "unknown"]
    assert sizes_in_time(found) == pytest.approx(np.array(sizes), abs=2e-3)


def scored(name: str, value: float, penalty: float = 0.0) -> SimpleNamespace:
    effect = SimpleNamespace(name=name, prior_penalty=penalty)
    return SimpleNamespace(hypothesis=SimpleNamespace(effect=effect), score=value)


def test_names_are_preferred_as_likely_as_they_are_beforehand(monkeypatch: pytest.MonkeyPatch) -> None:
    """A drift of d' 20 was undecided: a warm-up that is nearly straight came first, and did not stand."""
    drift, warm_up = scored("drift", 4.4, 1.5), scored("warm-up", 2.8)
    sharp = {"drift": drift, "warm-up": scored("warm-up", 4.9)}
    monkeypatch.setattr(search, "sharpened", lambda _, s, __: sharp[s.hypothesis.effect.name])
    step = search.prefer_named(None, Step(scored("unknown", 4.7), (drift, warm_up)), ())
    assert step.winner.hypothesis.effect.name == "drift"
    assert [s.hypothesis.effect.name for s in step.others] == ["unknown", "warm-up"]


@pytest.mark.parametrize("stands", ["named", "unknown"])
def test_where_two_steps_do_not_stand_together_the_first_is_tried_alone_before_its_rivals(
    stands: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Beside a course that follows anything no size is known: of few rests a right name was never stated."""

    first = Step(scored("named", 30.0), (scored("unknown", 28.0),))
    second = Step(scored("unknown", 10.0), ())
    tried = []

    def stands_so(residuals: object, steps: list[Step]) -> list[str]:
        tried.append([s.winner.hypothesis.effect.name for s in steps])
        return [stands] if tried[-1] == [stands] else []

    monkeypatch.setattr(standing, "_standing", stands_so)
    assert standing.statements_of(None, [first, second]) == [stands]
    assert tried == [["named", "unknown"], ["named"], ["unknown"]][: 2 if stands == "named" else 3]
