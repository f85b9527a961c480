"""Still devices: units of stamps, outliers, clusters; and the real ones against figures known otherwise."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from stillcal.replay.studies.claim import Verdict
from stillcal.replay.studies.har.recordings import Still, read_still, stamp_unit
from stillcal.replay.studies.stisen2015 import biases as biases_study
from stillcal.replay.studies.stisen2015 import clusters as clusters_study
from stillcal.replay.studies.stisen2015 import rests as rests_study
from stillcal.replay.studies.stisen2015 import timing as timing_study


@pytest.fixture(scope="module")
def still(data_dir: Path) -> list[Still]:
    return read_still(data_dir)


@pytest.mark.parametrize("unit", [1.0, 1e-3, 1e-6, 1e-9])
def test_unit_of_stamps_survives_an_outage_of_the_app(unit: float) -> None:
    made = np.arange(0.0, 70.0, 0.01)
    came = made + np.where(made > 35.0, 200.0, 0.0)
    assert stamp_unit(made / unit, came) == pytest.approx(unit)


def test_outliers_of_a_normal_sample() -> None:
    """Tukey's whiskers leave 0.698 % of a normal sample outside."""
    drawn = np.random.default_rng(0).normal(size=200_000)
    assert np.mean(timing_study.outliers(drawn)) == pytest.approx(0.00698, abs=4 * np.sqrt(0.007 / 200_000))


def intervals(*values: float) -> timing_study.BothStamps:
    """A hundred intervals of 10 ms, a little uneven, and those given beside them."""
    even = 10.0 + np.linspace(-0.5, 0.5, 100)
    made = np.concatenate([even, values])
    return timing_study.both_stamps(timing_study.Intervals(made, made))


def test_few_and_long_intervals_are_told_from_many() -> None:
    """Each of three models: none beyond the whiskers; 3 % that are long; 20 % that are a tick off."""
    even, long, ticks = (), (100.0,) * 3, (8.0, 12.0) * 10
    for beyond, few, means, explained in ((even, True, False, False), (long, True, True, False),
                                          (ticks, False, False, True)):  # fmt: skip
        found = {name: intervals(*beyond) for name in "abc"}
        outliers, far = timing_study._outliers(found)
        assert (outliers.verdict is Verdict.REPRODUCED) is few
        assert (far.verdict is Verdict.REPRODUCED) is means
        assert outliers.explained is explained
    one = {"a": intervals(*long), "b": intervals(), "c": intervals(), "d": intervals()}
    assert timing_study._outliers(one)[1].verdict is Verdict.DIFFERS  # one of four is not many
    many = {name: intervals(*(100.0,) * 20) for name in "abc"}
    assert not timing_study._outliers(many)[0].explained  # beyond, many, and long


def deviating(*sizes: float, model: str) -> biases_study.Deviations:
    """Devices of one model, each with one recording."""
    n = len(sizes)
    return biases_study.Deviations(
        np.array(sizes),
        np.array(["back"] * n),
        np.array([f"{model} {s}" for s in sizes]),
        np.array([model] * n),
    )


def joined(*parts: biases_study.Deviations) -> biases_study.Deviations:
    return biases_study.Deviations(
        *(np.concatenate([getattr(p, c) for p in parts]) for c in ("value", "face", "device", "model"))
    )


@pytest.mark.parametrize("old, verdict", [(0.4, Verdict.REPRODUCED), (0.0, Verdict.DIFFERS)])
def test_newer_models_are_compared_by_device(old: float, verdict: Verdict) -> None:
    """A model that Table 1 does not have has no year."""
    found = joined(
        deviating(*(old + 0.01 * k for k in range(4)), model="HTC-Desire"),
        deviating(*(-0.2 - 0.01 * k for k in range(4)), model="LG-Nexus4"),
        deviating(9.0, model="nameless"),
    )
    assert biases_study._newer(found).verdict is verdict


@pytest.mark.parametrize("watch, verdict", [(-0.19, Verdict.REPRODUCED), (-0.21, Verdict.DIFFERS)])
def test_watches_are_compared_by_the_size_of_their_biases(watch: float, verdict: Verdict) -> None:
    found = joined(deviating(watch, model="LG_G-Watch"), deviating(0.1, -0.3, model="LG-Nexus4"))
    assert biases_study._watches(found).verdict is verdict


def two_sensors(*scatters: tuple[float, float]) -> list[timing_study.BothStamps]:
    wave = np.tile([-1.0, 1.0], 50)
    both = [timing_study.Intervals(10.0 + a * wave, 10.0 + b * wave) for a, b in scatters]
    return [timing_study.both_stamps(own) for own in both]


@pytest.mark.parametrize(
    "gyroscope, verdict", [((0.9, 1.0), Verdict.REPRODUCED), ((1.1, 1.0), Verdict.DIFFERS)]
)
def test_both_sensors_scatter_more_by_arrival(gyroscope: tuple[float, float], verdict: Verdict) -> None:
    for sensors in (two_sensors((0.9, 1.0), gyroscope), two_sensors(gyroscope, (0.9, 1.0))):
        assert timing_study._gyro("Gear", *sensors, 16.0).verdict is verdict


@pytest.mark.parametrize("arrival, shown", [(1.0, True), (0.8, False)])
def test_gaps_are_a_cause_where_without_them_arrival_scatters_more(arrival: float, shown: bool) -> None:
    """Two gaps, which widen creation more than arrival."""
    wave = np.tile([-1.0, 1.0], 50)
    made, came = (np.r_[10.0 + a * wave, gap, gap] for a, gap in ((0.9, 200.0), (arrival, 150.0)))
    sensor = timing_study.both_stamps(timing_study.Intervals(made, came))
    claim = timing_study._gyro("Gear", sensor, sensor, 16.0)
    assert claim.verdict is Verdict.DIFFERS
    assert claim.explained is shown


def test_clusters_of_well_separated_groups() -> None:
    rng = np.random.default_rng(1)
    centres = np.array([[0.0, 0.0], [10.0, 0.0], [0.0, 10.0]])
    features = np.concatenate([c + 0.1 * rng.normal(size=(6, 2)) for c in centres])
    labels, exemplars = clusters_study.clusters(features, 0)
    assert len(exemplars) == 3
    assert [len(set(labels[k : k + 6])) for k in (0, 6, 12)] == [1, 1, 1]


def test_the_frozen_tablet_is_no_rest(still: list[Still]) -> None:
    frozen = {r.model for r in still if r.frozen}
    assert frozen == {"Samsung-Galaxy-Tab10.1"}


def test_stamps_are_seconds(still: list[Still]) -> None:
    """Median interval by creation within a tenth of Table 1, but for the S3, which never ran at 150 Hz."""
    found = timing_study.by_model(still)
    nominal = {model: 1e3 / rate for model, rate in timing_study.RATES_HZ.items() if model in found}
    assert "Samsung-Galaxy-S3" in nominal and len(nominal) > 5
    medians = {model: float(np.median(found[model].creation)) for model in nominal}
    assert medians.pop("Samsung-Galaxy-S3") > 1.1 * nominal.pop("Samsung-Galaxy-S3")
    assert medians == pytest.approx(nominal, rel=0.1)


def test_deviations_follow_the_reference(still: list[Still]) -> None:
    """The reference unit's own mean stands in the paper: 9.82 m/s^2, here within its faces' scatter."""
    found = biases_study.deviations([r for r in still if r.reference], g=9.82)
    assert len(found.value) == 6
    assert abs(found.value.mean()) < 3 * found.value.std(ddof=1) / np.sqrt(6)


def test_one_device_is_at_rest_and_a_frozen_one_is_not(still: list[Still]) -> None:
    phone = next(r for r in still if r.model == "LG-Nexus4")
    frozen = next(r for r in still if r.frozen)
    assert rests_study.detect(phone).share > 0.9
    assert rests_study.detect(frozen).rests == 0


def test_without_recordings_nothing_is_judged(tmp_path: Path) -> None:
    for module in (biases_study, timing_study, clusters_study, rests_study):
        study = module.study(None, tmp_path, 0, lambda share: None)
        assert {c.verdict for c in study.claims} == {Verdict.UNTESTED}
        assert not study.figures
