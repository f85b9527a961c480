"""The slow search on simple phones of known truth: silence on nulls, names, parameters, honesty."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache

import msgspec
import nulls
import numpy as np
import pytest

from stillcal.calib_core.codec import plain
from stillcal.calib_core.misfit import thresholds
from stillcal.calib_core.misfit.catalogue import slow_entries
from stillcal.calib_core.misfit.catalogue.entry import nothing
from stillcal.calib_core.misfit.catalogue.force import distinct
from stillcal.calib_core.misfit.evidence import null_log_likelihood, posterior_weights
from stillcal.calib_core.misfit.records import Finding
from stillcal.calib_core.misfit.scenes import scenes
from stillcal.calib_core.misfit.search import ranking, reduce_scene, score
from stillcal.calib_core.misfit.slow import slow_findings


def day_of(seed: int, rests: int = 20) -> tuple[np.random.Generator, nulls.Day]:
    """Draw days until one has enough rests in many attitudes, with the charger in and out."""
    rng = np.random.default_rng(seed)
    day = nulls.schedule(rng)
    while (
        day.rest.max() < rests
        or len(np.unique(np.diff(day.charging))) < 3
        or distinct(day.up[day.rest >= 0][::60]) < 10
    ):
        day = nulls.schedule(rng)
    return rng, day


@cache
def found(sensor: str, seed: int, family: str = "white", **kind: object) -> list[Finding]:
    rng, day = day_of(seed)
    driver = {"temperature": day.temperature, "charging": day.charging, "warmup": 1 - np.exp(-day.t / 300.0)}
    effect = {k: np.outer(driver[v[0]], v[1]) for k, v in kind.items() if k.endswith("_error")}  # type: ignore[index]
    flags = {k: v for k, v in kind.items() if not k.endswith("_error")}
    bins = nulls.bins_of(rng, day, family, **effect, **flags)
    return slow_findings(next(s for s in scenes(bins, nulls.G) if s.sensor == sensor))


@pytest.mark.parametrize("family", nulls.FAMILIES)
def test_silent_where_nothing_is_wrong(family: str) -> None:
    for seed in range(2):
        rng = np.random.default_rng([11, seed])
        bins = nulls.bins_of(rng, nulls.schedule(rng), family)
        for scene in scenes(bins, nulls.G):
            ranked = ranking(scene, slow_entries(scene.sensor))
            assert ranked[0].score < thresholds.SCORE if ranked else True


def linear(finding: Finding) -> Iterator[tuple[float, float, float]]:
    parameter = next(iter(finding.parameters.values()))
    for value, (low, high) in zip(parameter.value, parameter.ci95, strict=True):  # type: ignore[arg-type]
        yield value, low, high


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
    assert first.evidence.heldout_log_score_gain > 3.0
    assert first.evidence.p_value < 1e-3


def test_heat_is_found_without_a_thermometer() -> None:
    findings = found("accel", 5, "gm50", accel_error=("temperature", (0.01, 0.0, -0.008)), thermometer=False)
    assert findings[0].effect == "thermal_latent"
    assert set(findings[0].axes) == {"x", "z"}
    assert "tau_s" in findings[0].parameters


def test_a_thermometer_that_does_nothing_raises_no_alarm() -> None:
    assert found("accel", 8, "flicker") == []


def test_a_finding_encodes_to_the_documented_structure() -> None:
    finding = found("gyro", 5, "gm50", gyro_error=("charging", (4e-4, 0.0, 0.0)))[0]
    table = msgspec.json.decode(msgspec.json.encode(plain(finding)))
    assert set(table) == {
        "effect", "sensor", "axes", "where", "parameters", "evidence", "alternatives", "statement",
    }  # fmt: skip
    assert set(table["where"]) == {"t_start", "t_end", "band_hz", "driver"}
    assert table["parameters"]["step"]["unit"] == "rad/s"
    assert set(table["evidence"]) >= {"p_value", "heldout_rmse_before", "heldout_log_score_gain", "folds"}


def test_score_is_the_tail_of_f() -> None:
    """With one parameter and many degrees of freedom, a gain of z^2/2 scores as a normal deviate z."""
    assert score(4.0**2 / 2, 1, 1e7, 1) == pytest.approx(-np.log10(6.334e-5), rel=1e-3)
    assert score(8.0, 1, 1e7, 100) == pytest.approx(score(8.0, 1, 1e7, 1) - 2.0)


def test_shapes_find_the_wander_that_was_put_in() -> None:
    rng, day = day_of(4)
    expected = {"white": "white", "walk_strong": "walk"}
    for family, name in expected.items():
        bins = nulls.bins_of(rng, day, family)
        scene = scenes(bins, nulls.G)[1]
        reduced = reduce_scene(scene, [nothing(scene)])
        assert np.isfinite(null_log_likelihood(reduced))
        weight = posterior_weights(reduced[0])
        if name == "white":
            weak = sum(w for w, s in zip(weight, reduced[0].walk, strict=True) if s == 0.0)
            assert weak > 0.3
        else:
            share = {f: 0.0 for f in reduced[0].family}
            for f, w in zip(reduced[0].family, weight, strict=True):
                share[f] += float(w)
            assert max(share, key=lambda f: share[f]).startswith(("walk", "gauss_markov_960"))
