"""A gyroscope's nonlinearity from fast turns, where it is a good part of the rate itself."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stillcal.calib_core.diagnosis.effects.by_rate import RateNonlinearity
from stillcal.calib_core.diagnosis.model.hypothesis import SensorResiduals
from stillcal.calib_core.diagnosis.model.records import Evidence, Finding, Where
from stillcal.calib_core.diagnosis.model.rotation_alignment import Aligned, aligned
from stillcal.calib_core.diagnosis.segments.static_bins import cut
from stillcal.calib_core.diagnosis.segments.turns import Rates, as_read
from stillcal.calib_core.diagnosis.slow.estimate import Estimate, estimate, parameters
from stillcal.calib_core.diagnosis.slow.relinearised import about_effects
from stillcal.calib_core.diagnosis.slow.statement import Stated
from stillcal.calib_core.diagnosis.slow.turns.turn_residuals import turn_residuals
from stillcal.calib_core.streams.samples import Samples, Sensor
from tests.support.diagnosis.turning import ups

G, HZ, FINE = 9.80665, 100, 10
SCALE = np.array([1.01, 0.99, 1.005])


def fast_turns(cubic: float, seed: int, rests: int = 50) -> tuple[Samples, Samples]:
    """Fifty rests of 25 s in twenty attitudes, turns of 0.6 to 2.5 s between, of up to 8 rad/s."""
    rng = np.random.default_rng(seed)
    places = Rotation.random(20, random_state=seed)
    now, rates = places[0], []
    for _ in range(rests):
        target = places[int(rng.integers(20))]
        k = round(rng.uniform(0.6, 2.5) * HZ * FINE)
        swell = np.sin(np.pi * (np.arange(k) + 0.5) / k) ** 2
        turn = (now.inv() * target).as_rotvec()
        rates += [np.zeros((25 * HZ * FINE, 3)), swell[:, None] / swell.sum() * HZ * FINE * turn]
        now = target
    fine = np.concatenate(rates)
    up, w = ups(places[0], fine, HZ * FINE)[::FINE], fine[::FINE]
    t = np.arange(len(w)) / HZ
    force = G * up + rng.normal(0.0, 0.01, up.shape)
    read = SCALE * w + cubic * w**3 + 0.005 + rng.normal(0.0, 1e-3, w.shape)
    return (
        Samples.checked(Sensor.ACCELEROMETER, t, force),
        Samples.checked(Sensor.GYROSCOPE, t, read),
    )


def stated(residuals: SensorResiduals, found: Estimate) -> Stated:
    """Return a finding of the nonlinearity with the sizes of an estimate."""
    where, evidence = Where(0.0, 1.0, (0.0, 0.0), "rate of turn"), Evidence(1.0)
    finding = Finding("gyro_nonlinearity", "gyro", ["x"], where, parameters(found), evidence, [], "")
    return Stated(finding, found.hypothesis, residuals)


Again = Callable[[Rates], tuple[Aligned, SensorResiduals | None]]


def nonlinear(accelerometer: Samples, gyroscope: Samples) -> tuple[Again, Aligned, SensorResiduals, Estimate]:
    """Return what makes the turns of other rates, the turns as read, and the nonlinearity that they show."""
    bins = cut(accelerometer, gyroscope)

    def turned(rates: Rates) -> tuple[Aligned, SensorResiduals | None]:
        made = aligned(gyroscope, bins, G, rates=rates)
        return made, turn_residuals(made, bins, G)

    affine, residuals = turned(as_read)
    assert residuals is not None
    return turned, affine, residuals, estimate(residuals, residuals.hypothesis(RateNonlinearity(3), {}), [])


@pytest.mark.slow
@pytest.mark.parametrize("cubic", [2e-3, 2e-4])
def test_a_cubic_term_is_that_of_the_true_rate(cubic: float) -> None:
    accelerometer, gyroscope = fast_turns(cubic, 1)
    again, affine, residuals, first = nonlinear(accelerometer, gyroscope)
    if cubic > 1e-3:
        assert (first.value[3:] < cubic - 3.0 * first.sigma[3:]).any(), "as read, it is too small"
    finding = about_effects([stated(residuals, first)], (affine, residuals), as_read, again)[0][0].finding
    told = finding.parameters["cubic"]
    sigma = np.diff(np.asarray(told.ci95), axis=1).ravel() / (2.0 * 1.96)
    assert (np.abs(np.asarray(told.value) - cubic) < 3.5 * sigma).all(), (told.value, sigma)
    assert (sigma < 0.1 * max(cubic, 3e-4)).all()
    assert finding.statement, "it says the new size"


def test_of_an_effect_that_grows_without_end_the_sizes_stay_as_they_were_found() -> None:
    """The diagnosis of a real session ended in an error of the least squares: its sizes ran away."""
    accelerometer, gyroscope = fast_turns(0.0, 1, rests=12)
    again, affine, residuals, first = nonlinear(accelerometer, gyroscope)
    one = stated(residuals, replace(first, value=np.full(6, 1e3)))
    assert about_effects([one], (affine, residuals), as_read, again) == ([one], None)
