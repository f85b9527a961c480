"""A name whose form the recording does not keep says so, or goes; a form that is kept costs no name."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from stillcal.calib_core.diagnosis.comparison.records import Comparison, Discrepancy
from stillcal.calib_core.diagnosis.effects.temperature import BiasTemperature
from stillcal.calib_core.diagnosis.effects.timed import Charging, Drift
from stillcal.calib_core.diagnosis.effects.warmup import LatentHeat, Warmup
from stillcal.calib_core.diagnosis.model.effect import Effect
from stillcal.calib_core.diagnosis.model.hypothesis import SensorResiduals
from stillcal.calib_core.diagnosis.model.moments import first_order
from stillcal.calib_core.diagnosis.model.records import Departure, Evidence, Finding, Where
from stillcal.calib_core.diagnosis.model.sensor_residuals import by_sensor
from stillcal.calib_core.diagnosis.slow import form
from stillcal.calib_core.diagnosis.slow.estimate import Estimate, estimate
from stillcal.calib_core.diagnosis.slow.search import Scored, Step, compete, proposals
from stillcal.calib_core.streams.time_series import TimeSeries
from tests.calib_core.diagnosis.slow.test_findings import day_of
from tests.calib_core.diagnosis.slow.test_off_catalogue import QUIET, SECONDS, short_day
from tests.support.diagnosis import nulls
from tests.support.diagnosis.said import findings_of

Array = np.ndarray
SEED = 6


@cache
def today() -> nulls.Day:
    return short_day(SEED)


def late(curve: Array, tau: float) -> Array:
    return first_order(TimeSeries(today().t, curve), tau).at(today().t)


def curves(kind: str) -> Array:
    day = today()
    warm = day.temperature - day.temperature.mean()
    plugged = day.charging.astype(float)
    return {
        "charging": plugged,
        "charging, in part late": 0.4 * plugged + 0.6 * late(plugged, 120.0),
        "temperature": warm / np.ptp(warm),
        "temperature, with an end": np.tanh(4.0 * warm / np.ptp(warm)) / 2.0,
        "temperature, less and less": warm / np.ptp(warm) * (1.5 - day.t / day.t[-1]),
        "warm-up": -np.expm1(-day.t / 150.0),
        "warm-up, of two parts": -0.5 * np.expm1(-day.t / 40.0) - 0.5 * np.expm1(-day.t / 500.0),
    }[kind]


def scene_of(*errors: Array, thermometer: bool = True) -> SensorResiduals:
    rng, _ = day_of(SEED, seconds=SECONDS)
    error = np.sum(errors, axis=0)
    bins = nulls.bins_of(rng, today(), QUIET, gyro_error=error, thermometer=thermometer)
    return by_sensor(bins, nulls.G)[1]


def on_axes(kind: str, sizes: tuple[float, float, float] = (2e-3, 0.0, -1e-3)) -> Array:
    return np.outer(curves(kind), sizes)


def steps_of(residuals: SensorResiduals, *effects: Effect) -> tuple[list[Step], list[Estimate]]:
    """Each effect at its best point, its rivals the others, with the others free beside it."""
    found: list[Scored] = []
    for effect in effects:
        found += compete(residuals, proposals(residuals, [effect]), [s.hypothesis for s in found])
    steps = [Step(s, tuple(o for o in found if o is not s)) for s in found]
    return steps, [
        estimate(residuals, s.hypothesis, [o.hypothesis for o in found if o is not s]) for s in found
    ]


def doubted(residuals: SensorResiduals, *effects: Effect) -> str:
    steps, estimates = steps_of(residuals, *effects)
    step = form.doubted(residuals, steps, estimates, form.departures_of(residuals, estimates))
    return "" if step is None else step.winner.hypothesis.effect.name


@pytest.mark.parametrize(
    ("kind", "effect", "way"),
    [
        ("charging", Charging("gyro"), ""),
        ("charging, in part late", Charging("gyro"), form.LATE),
        ("temperature", BiasTemperature("gyro"), ""),
        ("temperature, with an end", BiasTemperature("gyro"), form.BENT),
        ("temperature, less and less", BiasTemperature("gyro"), form.CHANGING),
        ("warm-up", Warmup("gyro"), ""),
        ("warm-up, of two parts", Warmup("gyro"), form.LATE),
    ],
)
def test_what_follows_a_driver_in_another_form_departs_from_its_name(
    kind: str, effect: Effect, way: str
) -> None:
    residuals = scene_of(on_axes(kind))
    (found,) = steps_of(residuals, effect)[1]
    told = form.stated(form.departure(residuals, found, []), found)
    assert ("" if told is None else told.way) == way
    if told is not None:
        assert told.probability > 0.95
        assert 0.1 < told.part < 1.0


def test_a_second_name_may_be_how_the_first_one_departs() -> None:
    warm_up = scene_of(on_axes("warm-up, of two parts"))
    assert doubted(warm_up, Warmup("gyro"), Drift("gyro")) == "gyro_bias_drift"
    two = scene_of(on_axes("temperature"), on_axes("charging", (0.0, 1e-3, 0.0)))
    assert doubted(two, BiasTemperature("gyro"), Charging("gyro")) == ""


@pytest.mark.slow
@pytest.mark.parametrize(("rival", "name"), [(True, "unknown"), (False, "thermal_latent")])
def test_where_another_name_comes_as_near_neither_is_told(rival: bool, name: str) -> None:
    """A charger's bias that comes late in part is no heat, which comes late as a whole."""
    residuals = scene_of(on_axes("charging, in part late"), thermometer=False)
    heat, charging = (
        compete(residuals, proposals(residuals, [e]))[0] for e in (LatentHeat("gyro"), Charging("gyro"))
    )
    (only,) = findings_of(residuals, [Step(heat, (charging,) if rival else ())])
    assert only.effect == name
    assert (only.departure is None) == rival


def test_a_name_whose_form_is_not_kept_is_not_the_whole() -> None:
    where = Where(0.0, 1.0, (0.0, 0.05), "charging")
    for departure, verdict in ((None, "identified"), (Departure(9.0, 0.3, form.LATE), "partly_identified")):
        finding = Finding("gyro_charging_bias", "gyro", ["x"], where, {}, Evidence(9.0), [], "", departure)
        found = Discrepancy(
            "gyro_charging_bias", "gyro", ["x"], where, "lacking", 0.99, 9.0, recorded=finding
        )
        assert Comparison([found], comparisons=9).verdict(p_after=0.5) == verdict
