"""What an accelerometer adds that is no small part of the force: a nonlinearity, a slope in temperature."""

from __future__ import annotations

import numpy as np
import pytest

from stillcal.calib_core.diagnosis.effects.catalogue import effects_of
from stillcal.calib_core.diagnosis.effects.covariate import covariate_effects
from stillcal.calib_core.diagnosis.effects.temperature import BiasTemperature
from stillcal.calib_core.diagnosis.effects.timed import Step
from stillcal.calib_core.diagnosis.model.hypothesis import Hypothesis, SensorResiduals
from stillcal.calib_core.diagnosis.model.sensor_residuals import by_sensor
from stillcal.calib_core.diagnosis.segments.static_bins import Bins
from stillcal.calib_core.diagnosis.slow.about_force import about_nonlinearity, about_point, searched
from stillcal.calib_core.diagnosis.slow.findings import slow_statements
from tests.support.diagnosis import nulls
from tests.support.diagnosis.said import slow_findings

AXES = np.array([1.0, -0.7, 0.5])
SEED, RESTS = 1, 40


def rests(quadratic: float) -> Bins:
    """Return an hour of short rests in 20 attitudes. quadratic: 1/(m/s^2), of what each axis reads."""
    rng = np.random.default_rng(SEED)
    t = np.arange(3600.0)
    rest, left = np.divmod(t.astype(int), 3600 // RESTS)
    up = nulls.random_attitudes(rng, 20)[rest % 20]
    day = nulls.Day(t, np.where(left < 70, rest, -1), up, np.full(t.size, 25.0), np.zeros(t.size))
    # The scale that the phone is given is the next that its generator draws.
    state = rng.bit_generator.state
    scale = np.eye(3) + rng.normal(0, 0.01, (3, 3))
    rng.bit_generator.state = state
    error = quadratic * AXES * (nulls.G * up @ scale.T) ** 2
    quiet = {sensor: nulls.Wander() for sensor in nulls.WHITE}
    return nulls.bins_of(rng, day, quiet, accel_error=error)


def force_of(bins: Bins) -> SensorResiduals:
    """Return the accelerometer's residuals about its nonlinearity."""
    return about_nonlinearity(by_sensor(bins, nulls.G))[0]


@pytest.mark.slow
@pytest.mark.parametrize("quadratic", [3e-3, 1e-2])
def test_a_square_of_a_good_part_of_the_force_has_its_name_and_its_size(quadratic: float) -> None:
    """3 and 10 % of the force at 1 g: linear in both about none, they were unknown."""
    (found,) = slow_findings(force_of(rests(quadratic)))
    assert found.effect == "accel_nonlinearity" and found.axes == ["x", "y", "z"]
    sizes = np.ravel(found.parameters["quadratic"].value)
    np.testing.assert_allclose(sizes, quadratic * AXES, rtol=0.01)


def test_a_linear_accelerometer_stays_as_it_is() -> None:
    made = by_sensor(rests(0.0), nulls.G)
    assert about_nonlinearity(made)[0] is made[0] and about_nonlinearity(made)[1] is made[1]


SLOPE = np.array([8e-3, -6e-3, 1e-2])


STEP, AT = np.array([0.05, -0.04, 0.05]), 461.0


def warming(size: float, *, step: float = 0.0, seed: int = SEED) -> Bins:
    """Return 15 min of rests in 15 attitudes, warmer by 7 K in the end.

    size: of a slope in temperature; step: of a jump of the bias between two rests.
    """
    rng = np.random.default_rng(seed)
    t = np.arange(900.0)
    rest, left = np.divmod(t.astype(int), 60)
    warm = 24.0 + 8.0 * (1.0 - np.exp(-t / 360.0))
    up = nulls.random_attitudes(rng, 15)[rest]
    day = nulls.Day(t, np.where(left < 55, rest, -1), up, warm, np.zeros(t.size))
    quiet = {sensor: nulls.Wander() for sensor in nulls.WHITE}
    error = size * np.outer(warm - 24.0, SLOPE) + step * np.outer(t >= AT, STEP)
    return nulls.bins_of(rng, day, quiet, accel_error=error)


def test_a_bias_that_changes_much_leaves_nothing_else_about_the_point_found() -> None:
    """Linear about the mean bias, a slope of 3 % of gravity in all was a warm-up."""
    _, (found,) = searched(by_sensor(warming(4.0), nulls.G)[0])
    assert found.finding.effect == "accel_bias_temperature"
    np.testing.assert_allclose(found.finding.parameters["slope"].value, 4.0 * SLOPE, rtol=0.01)


def test_a_step_is_taken_off_at_the_moment_at_which_it_stands_beside_the_slope() -> None:
    """The search's own moment, told before the slope was known, was two bins off."""
    stated = slow_statements(by_sensor(warming(1.0, step=1.0, seed=2), nulls.G)[0])
    (step,) = (s for s in stated if s.finding.effect == "accel_bias_step")
    assert len(stated) == 2 and step.hypothesis is not None
    assert step.hypothesis.grid["t_start"] == step.finding.where.t_start
    assert step.hypothesis.grid["t_start"] == pytest.approx(AT, abs=5.0)


def test_only_what_is_sought_is_searched_for() -> None:
    """What a simulation was made with: nothing else is weighed against it, nor named in its place."""
    made, gyro = by_sensor(warming(4.0), nulls.G)
    warm = made.hypothesis(BiasTemperature("accel"), {})
    (own,) = slow_statements(made, sought=[warm, made.hypothesis(Step("gyro"), {"t_start": AT})])
    assert own.finding.effect == "accel_bias_temperature"
    of_turns, of_a_column = effects_of("gyro", in_turns=True)[0], covariate_effects("accel", "volt", 1.0)[0]
    for residuals, effect in ((made, Step("gyro")), (made, of_a_column), (gyro, of_turns)):
        assert slow_statements(residuals, sought=[Hypothesis(effect, {"t_start": AT}, ())]) == []


def test_what_is_sought_is_found_though_neither_of_two_stands_out_alone() -> None:
    """Searched for one by one, neither the slope nor the step stood out of what the other does."""
    made = by_sensor(warming(1.5, step=-1.0, seed=3), nulls.G)[0]
    known = [made.hypothesis(BiasTemperature("accel"), {}), made.hypothesis(Step("accel"), {"t_start": AT})]
    slope, step = (s.finding for s in slow_statements(made, sought=known))
    np.testing.assert_allclose(slope.parameters["slope"].value, 1.5 * SLOPE, rtol=0.2)
    np.testing.assert_allclose(step.parameters["step"].value, -STEP, rtol=0.2)


def test_a_steady_accelerometer_is_searched_once() -> None:
    made = by_sensor(warming(0.0), nulls.G)[0]
    assert searched(made)[0] is made


def test_what_is_taken_off_the_force_is_put_back_across_gravity_too() -> None:
    """A step is not sought across gravity, where it shows: about one found late it seemed a sixth."""
    rng = np.random.default_rng(SEED)
    t = np.arange(1800.0)
    rest, left = np.divmod(t.astype(int), 300)
    up = nulls.random_attitudes(rng, 6)[rest]
    day = nulls.Day(t, np.where(left < 295, rest, -1), up, np.full(t.size, 25.0), np.zeros(t.size))
    quiet = {sensor: nulls.Wander() for sensor in nulls.WHITE}
    step = np.outer(t >= 1040.0, [0.06, -0.05, 0.05])
    made = by_sensor(nulls.bins_of(rng, day, quiet, accel_error=step), nulls.G)[0]
    late = made.hypothesis(Step("accel"), {"t_start": 1045.0})
    moved = about_point(made, [late])
    before, after = (r.views[1] for r in (made, moved))
    assert moved is not made and before.name == "tangent"
    own = np.flatnonzero(before.rest == 3)
    jumps = [np.linalg.norm(v.y[:, own[-1]] - v.y[:, own[0]]) for v in (before, after)]
    assert jumps[1] == pytest.approx(jumps[0], rel=0.1)
