"""What is outside the catalogue is called unknown; what wanders too much is called a walk; both by theory."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from stillcal.calib_core.diagnosis.effects import curves
from stillcal.calib_core.diagnosis.effects.by_force import ForceNonlinearity
from stillcal.calib_core.diagnosis.effects.catalogue import effects_of
from stillcal.calib_core.diagnosis.effects.unknown import ForceCurve, GainBySign, Settling
from stillcal.calib_core.diagnosis.effects.warmup import Warmup
from stillcal.calib_core.diagnosis.inference.likelihood import (
    fit_hypothesis,
    null_log_likelihood,
    reduce_residuals,
)
from stillcal.calib_core.diagnosis.model import residuals as views
from stillcal.calib_core.diagnosis.model import settings as thresholds
from stillcal.calib_core.diagnosis.model.effect import Dictionary
from stillcal.calib_core.diagnosis.model.hypothesis import Hypothesis, SensorResiduals
from stillcal.calib_core.diagnosis.model.records import Finding
from stillcal.calib_core.diagnosis.model.sensor_residuals import by_sensor
from stillcal.calib_core.diagnosis.slow import statement
from stillcal.calib_core.diagnosis.slow.screen import hypothesis, screened
from stillcal.calib_core.diagnosis.slow.search import Scored, Step, compete, prefer_named, proposals, ranking
from tests.calib_core.diagnosis.slow.test_findings import day_of
from tests.support.diagnosis import effects, nulls
from tests.support.diagnosis.said import findings_of, slow_findings

Array = np.ndarray
QUIET = {sensor: nulls.Wander(pink=0.1 * white) for sensor, white in nulls.WHITE.items()}


SECONDS = 2400
"""Of most days here: in forty minutes what has no name shows beyond doubt."""


def short_day(seed: int) -> nulls.Day:
    return day_of(seed, seconds=SECONDS)[1]


def gyro_of(
    seed: int, error: Array | None, day: nulls.Day | None = None, seconds: int = SECONDS
) -> tuple[SensorResiduals, nulls.Day]:
    rng, drawn = day_of(seed, seconds=seconds)
    bins = nulls.bins_of(rng, day or drawn, QUIET, gyro_error=error)
    return by_sensor(bins, nulls.G)[1], day or drawn


def said(seed: int, curve: Array, size: float = 4e-4, without: tuple[str, ...] = ()) -> list[Finding]:
    residuals, _ = gyro_of(seed, np.outer(curve, [size, 0.0, -size / 2]))
    return slow_findings(residuals, without)


@pytest.mark.slow
def test_a_bias_that_comes_and_goes_is_unknown_with_its_stretch() -> None:
    day = short_day(6)
    found = said(6, ((day.t > 1200) & (day.t < 1900)).astype(float))
    assert [f.effect for f in found] == ["unknown"]
    assert found[0].where.t_start == pytest.approx(1200, abs=60)
    assert found[0].where.t_end == pytest.approx(1900, abs=60)


@pytest.mark.parametrize(("taus", "named"), [((85.0,), True), ((40.0, 700.0), False)])
def test_what_settles_as_no_first_order_system_does_is_no_warmup(
    taus: tuple[float, ...], named: bool
) -> None:
    """A single exponential keeps its name, half-way between two points of the coarse grid."""
    day = short_day(6)
    curve = sum(1.0 - np.exp(-day.t / tau) for tau in taus)
    residuals, _ = gyro_of(6, np.outer(curve, [1e-2, 0.0, -5e-3]))
    first, *others = compete(residuals, proposals(residuals, [Warmup("gyro"), Settling("gyro")]))
    step = prefer_named(residuals, Step(first, tuple(others)), [])
    assert first.score > 3.0 * thresholds.SCORE
    assert (step.winner.hypothesis.effect.name == "gyro_warmup") == named


@pytest.mark.parametrize("size", [0.03, 0.016])
@pytest.mark.parametrize(("power", "named"), [(2.0, True), (1.0, False)])
def test_a_gain_that_differs_by_sign_is_no_square_of_the_force(
    power: float, named: bool, size: float
) -> None:
    rng, day = day_of(6)
    # Forty rests of 90 s, each in an attitude of its own.
    day.rest[:] = np.where(day.t % 90.0 < 80.0, day.t // 90.0, -1)
    day.up[:] = nulls.random_attitudes(rng, 41)[day.rest]
    error = size * np.abs(day.up) ** power * [1.0, 0.7, -0.8]
    residuals = by_sensor(nulls.bins_of(rng, day, QUIET, error), nulls.G)[0]
    first, *others = compete(
        residuals, proposals(residuals, [ForceNonlinearity(2), ForceCurve(), GainBySign()])
    )
    step = prefer_named(residuals, Step(first, tuple(others)), [])
    assert first.score > 3.0 * thresholds.SCORE
    assert (step.winner.hypothesis.effect.name == "accel_nonlinearity") == named


@pytest.mark.parametrize("by_force", [True, False])
def test_a_gain_that_changes_once_is_no_step_of_the_bias(by_force: bool) -> None:
    """In a dozen attitudes a step and a nonlinearity were named for it: the grid had not its moment."""
    rng, day = np.random.default_rng(3), short_day(6)
    day = nulls.Day(*(x[:600] for x in (day.t, day.rest, day.up, day.temperature, day.charging)))
    day.rest[:] = np.where(day.t % 50.0 < 45.0, day.t // 50.0, -1)
    day.up[:] = nulls.random_attitudes(rng, 12)[day.rest]
    change = 0.02 * nulls.G * day.up if by_force else np.full((600, 3), [0.12, -0.05, 0.08])
    error = change * (day.t >= 333.0)[:, None]
    bins = nulls.bins_of(rng, day, QUIET, error, thermometer=False, charger=False)
    residuals = by_sensor(bins, nulls.G)[0]
    every = effects_of("accel")
    rivals = [e for e in every if e.name == "accel_bias_step" or getattr(e, "what", "") == "gain"]
    first = ranking(residuals, rivals)[0]
    assert first.score > 3.0 * thresholds.SCORE
    assert (first.hypothesis.effect.name == "unknown") == by_force


@pytest.mark.slow
def test_a_cycle_is_unknown_with_its_period() -> None:
    day = short_day(6)
    found = said(6, np.sin(2 * np.pi * day.t / 400.0))
    (only,) = found
    assert only.effect == "unknown"
    period = only.parameters["period_s"]
    low, high = period.ci95  # type: ignore[misc]
    assert low < 400.0 < high
    assert high - low < 40.0


@pytest.mark.slow
def test_a_curve_that_no_polynomial_is_follows_temperature_without_a_name() -> None:
    day = short_day(5)
    warm = day.temperature - np.quantile(day.temperature, 0.3)
    found = said(5, np.tanh(warm / (0.1 * np.ptp(warm))))
    assert {f.effect for f in found} == {"unknown"}
    # Twice as sharp it is two levels in time, with 18 nats more than as a curve of temperature.
    assert found[0].where.driver == "temperature's past or bend"


@pytest.mark.parametrize("lag", [28.0, 60.0, 110.0])
def test_a_bias_that_comes_late_in_a_chamber_follows_temperature_and_no_period(lag: float) -> None:
    """The chamber's temperature is a sine, and so is a bias behind it, but for its beginning."""
    t = np.arange(1000.0)
    day = nulls.Day(t, np.where(t % 30.0 < 26.0, t // 30.0, -1).astype(int), *np.zeros((3, 1000)))
    rng, now = np.random.default_rng(2), -np.cos(4e-3 * np.pi * t)
    day.up, day.temperature = nulls.random_attitudes(rng, 34)[day.rest], 25.0 + 12.0 * now
    keep = float(np.exp(-1.0 / lag))
    late = lfilter([1.0 - keep], [1.0, -keep], now - now[0]) + now[0]
    error = np.outer(late, 12.0 * np.array([3e-4, -2e-4, 1e-4]))
    residuals = by_sensor(nulls.bins_of(rng, day, QUIET, gyro_error=error, charger=False), nulls.G)[1]
    rivals = [
        e for e in effects_of("gyro") if e.follows in ("a period in time", "temperature's past or bend")
    ]
    assert ranking(residuals, rivals)[0].hypothesis.effect.follows == "temperature's past or bend"


def test_an_effect_taken_out_of_the_catalogue_is_unknown_and_says_what_it_follows() -> None:
    day = short_day(5)
    found = said(5, day.temperature - day.temperature.mean(), 2e-4, ("gyro_bias_temperature",))
    assert {f.effect for f in found} == {"unknown"}
    assert "temperature" in found[0].where.driver


@pytest.mark.slow
def test_a_force_that_follows_the_product_of_the_other_two_is_unknown_and_follows_attitude() -> None:
    rng, day = day_of(6)
    # Forty rests of 90 s, each in an attitude of its own.
    day.rest[:] = np.where(day.t % 90.0 < 80.0, day.t // 90.0, -1)
    day.up[:] = nulls.random_attitudes(rng, 41)[day.rest]
    error = np.zeros((day.t.size, 3))
    error[:, 0] = 0.015 * day.up[:, 1] * day.up[:, 2]
    residuals = by_sensor(nulls.bins_of(rng, day, "white", error), nulls.G)[0]
    (found,) = slow_findings(residuals)
    assert (found.effect, found.where.driver) == ("unknown", "attitude, nonlinearly")


@pytest.mark.slow
def test_a_step_within_a_bin_is_timed_within_it() -> None:
    """A jump of a hundred times a bin's noise leaves no doubt of a time to a tenth of a bin of 18 s."""
    day = short_day(6)
    at = 1703.0
    while day.rest[int(at)] < 0:
        at += 7.0
    found = said(6, (day.t >= at).astype(float), 4e-3)
    assert [f.effect for f in found] == ["gyro_bias_step"]
    assert found[0].where.t_start == pytest.approx(at, abs=2.0)


@pytest.mark.slow
@pytest.mark.parametrize(("ratio", "named"), [(0.4, False), (5.0, True)])
def test_a_walk_is_named_only_beyond_what_a_phone_may_have(ratio: float, named: bool) -> None:
    rng, day = day_of(9)
    walk = {s: nulls.Wander(walk=ratio * thresholds.RANDOM_WALK[s]) for s in nulls.WHITE}
    bins = nulls.bins_of(rng, day, walk)
    for residuals in by_sensor(bins, nulls.G):
        found = slow_findings(residuals)
        assert [f.effect for f in found] == [f"{residuals.sensor}_bias_random_walk"] * named
        if named:
            for low, high in found[0].parameters["density"].ci95:
                assert low < ratio * thresholds.RANDOM_WALK[residuals.sensor] < high


def test_wander_does_not_bend_the_baseline() -> None:
    """Seven rests are not enough for nine parameters: what they wander must not go into scale and bias."""
    rng = np.random.default_rng([31, 1])
    day = nulls.schedule(rng)
    bins = nulls.bins_of(rng, day, {s: nulls.Wander(walk=1e-3) for s in nulls.WHITE})
    baseline = views.fit_baseline(bins.force, bins.force_variance, bins.rest, nulls.G)
    assert np.abs(baseline.scale - np.eye(3)).max() < 2 * views.SCALE_SIZE
    assert np.abs(baseline.bias).max() < 2 * views.BIAS_SIZE


def test_screening_keeps_the_curve_that_was_put_in() -> None:
    day = short_day(6)
    residuals, _ = gyro_of(6, np.outer((day.t > 900) & (day.t < 1500), [4e-4, 0.0, 0.0]))
    effect = next(e for e in effects_of("gyro") if getattr(e, "many", None) is curves.pulses)
    empty = reduce_residuals(residuals)
    kept = screened(residuals, [effect], empty, [])
    reduced = reduce_residuals(residuals, kept)
    gains = [
        fit_hypothesis(reduced, i).log_likelihood - null_log_likelihood(reduced) for i in range(len(kept))
    ]
    best = kept[int(np.argmax(gains))].grid
    assert best["t_start"] == pytest.approx(900, abs=40)
    assert best["t_end"] == pytest.approx(1500, abs=40)


def test_a_pair_is_the_difference_of_its_curves() -> None:
    residuals, _ = gyro_of(6, None)
    effect = next(e for e in effects_of("gyro") if getattr(e, "many", None) is curves.pulses)
    many = curves.pulses(residuals.moments)
    assert many is not None and many.pairs is not None
    a, b = many.pairs[7]
    plain = Dictionary(many.grids[:1], (many.curves[a] - many.curves[b])[None], 1)
    for one, other in zip(
        hypothesis(effect, residuals, many, 7).columns,
        hypothesis(effect, residuals, plain, 0).columns,
        strict=True,
    ):
        assert np.array_equal(one, other)


def test_true_noise_of_the_trials_has_the_covariance_they_reckon_with() -> None:
    """Bins of a thousand drawn wanders scatter as `Wander.covariance` says, to four standard errors."""
    day = nulls.schedule(np.random.default_rng(3), 600)
    average = nulls.cut(day, 60.0)[2]
    wander = nulls.Wander(0.5, ((80.0, 0.7),), 0.02)
    rng = np.random.default_rng(4)
    drawn = np.concatenate([(average @ wander.series(rng, 600)).T for _ in range(334)])
    expected = np.diag(wander.covariance(average))
    assert drawn.var(axis=0) == pytest.approx(expected, rel=4 * np.sqrt(2 / len(drawn)))


def test_every_effect_outside_the_catalogue_can_be_drawn() -> None:
    rng, day = day_of(6)
    for kind in effects.OFF_CATALOGUE:
        put = effects.drawn(rng, day, kind, "gyro")
        assert put.name is None
        assert np.ptp(put.error) > 0.0


@pytest.mark.slow
def test_a_name_that_left_out_parts_do_not_speak_for_gives_way_to_structure_without_one() -> None:
    day = short_day(6)
    residuals, _ = gyro_of(6, np.outer(np.sin(2 * np.pi * day.t / 500.0), [4e-4, 0.0, -2e-4]))
    period = ranking(residuals, effects_of("gyro"))[0]
    drift = proposals(residuals, [e for e in effects_of("gyro") if e.name == "gyro_bias_drift"])[0]
    name = Scored(drift, fit_hypothesis(reduce_residuals(residuals, [drift]), 0), 5.0, 10.0)
    assert [f.effect for f in findings_of(residuals, [Step(name, (period,))])] == ["unknown"]
    preferred = replace(name, score=period.score + 1.0)
    assert [f.effect for f in findings_of(residuals, [Step(preferred, (period,))])] == ["unknown"]
    assert findings_of(residuals, [Step(name, ())]) == []


def test_where_neither_the_first_nor_its_first_rival_stands_the_others_are_tried() -> None:
    """A step of a bias was "no difference" though the search was sure of it: two shapes near it fell."""
    day = short_day(6)
    residuals, _ = gyro_of(6, np.outer(np.sin(2 * np.pi * day.t / 500.0), [4e-4, 0.0, -2e-4]))
    period = ranking(residuals, effects_of("gyro"))[0]
    drifts = proposals(residuals, [e for e in effects_of("gyro") if e.name == "gyro_bias_drift"])
    fit = fit_hypothesis(reduce_residuals(residuals, drifts[:1]), 0)
    first, second = (Scored(drifts[0], fit, period.score + more, 10.0) for more in (1.0, 2.0))
    assert findings_of(residuals, [Step(first, (second,))]) == []
    assert [f.effect for f in findings_of(residuals, [Step(first, (second, period))])] == ["unknown"]


def test_that_something_is_there_is_as_likely_as_any_name_that_it_may_have(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A step whose name some parts did not bear out was undecided as what has none, and not told at all."""
    day = short_day(6)
    residuals, _ = gyro_of(6, np.outer(np.sin(2 * np.pi * day.t / 500.0), [4e-4, 0.0, -2e-4]))
    period = ranking(residuals, effects_of("gyro"))[0]
    drift = proposals(residuals, [e for e in effects_of("gyro") if e.name == "gyro_bias_drift"])[0]
    name = Scored(drift, fit_hypothesis(reduce_residuals(residuals, [drift]), 0), 5.0, 10.0)

    def evidence(_: object, one: Hypothesis, __: object) -> float:
        return 5.9 if one.effect.name == "unknown" else 8.8

    monkeypatch.setattr(statement, "evidence_of", evidence)
    (found,) = findings_of(residuals, [Step(period, (name,))])
    assert (found.effect, found.evidence.log_bayes_factor) == ("unknown", 8.8)


@pytest.mark.slow
def test_what_does_not_stand_beside_a_name_does_not_take_it_away() -> None:
    _, day = day_of(7)
    residuals, _ = gyro_of(7, np.outer(1.0 - np.exp(-day.t / 300.0), [5e-4, 0.0, -2.5e-4]), seconds=3600)
    warmup = ranking(residuals, effects_of("gyro"))[0]
    beside = ranking(residuals, effects_of("gyro"), [warmup.hypothesis])
    settling = next(s for s in beside if isinstance(s.hypothesis.effect, Settling))
    nearly = replace(settling, score=5.0, gain=10.0)
    assert [f.effect for f in findings_of(residuals, [Step(warmup, ()), Step(nearly, ())])] == ["gyro_warmup"]
