"""The static bins that slow effects are judged on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from stillcal.calib_core.diagnosis.clear_bins import roughened
from stillcal.calib_core.diagnosis.diagnose import diagnose
from stillcal.calib_core.diagnosis.direct.quantisation import Steps
from stillcal.calib_core.diagnosis.segments.rests.rest_edges import RestEdges
from stillcal.calib_core.diagnosis.segments.static_bins import cut
from stillcal.calib_core.streams.events import Charging
from stillcal.calib_core.streams.samples import Samples, Sensor

RATE = 10.0
SWITCHES = (300.0, 700.0, 1100.0, 1500.0, 2000.0)


def plugged(late: float) -> tuple[Samples, Samples, list[Charging]]:
    """Leave a phone on a table for 40 min; the plug moves its rate's bias. Events come `late` s after it."""
    rng = np.random.default_rng(5)
    t = np.arange(2400 * RATE) / RATE
    charging = np.searchsorted(SWITCHES, t, side="right") % 2
    force = np.array([0.0, 0.0, 9.80665]) + rng.normal(0.0, 0.01, (t.size, 3))
    rate = charging[:, None] * np.array([1.5e-3, -1e-3, 2e-3]) + rng.normal(0.0, 1e-3, (t.size, 3))
    events = [Charging(s + late, k % 2 == 0) for k, s in enumerate(SWITCHES)]
    return (
        Samples.checked(Sensor.ACCELEROMETER, t, force),
        Samples.checked(Sensor.GYROSCOPE, t, rate),
        events,
    )


def test_the_rounding_of_an_axis_is_shared_whatever_the_other_axes_round_to() -> None:
    """The means of x all round to one code, those of y and z to 25 different pairs."""
    rng = np.random.default_rng(3)
    accelerometer, gyroscope, _ = plugged(0.0)
    bins = cut(accelerometer, gyroscope)
    step, n = 1e-3, len(bins)
    rate = step * np.column_stack([np.full(n, 3.0), rng.integers(-2, 3, (n, 2))])
    coarse = replace(bins, rate=rate, rate_variance=np.full((n, 3), 1e-5), rate_rounding=np.full(3, 2e-4))
    fine = Steps(np.full(3, 1e-5), np.ones(3))
    seen = {"accel": fine, "gyro": Steps(np.full(3, step), np.zeros(3))}
    variance = roughened(coarse, seen).rate_variance
    assert variance is not None
    assert variance[:, 0] == pytest.approx(1e-5 + n * 2e-4**2)
    assert variance[:, 1].mean() - 1e-5 == pytest.approx(n / 5.0 * 2e-4**2, rel=0.1)


@pytest.mark.parametrize(
    "late", [pytest.param(0.0, marks=pytest.mark.slow), 1.3, pytest.param(2.5, marks=pytest.mark.slow)]
)
def test_a_bias_of_the_plug_is_named_though_its_events_come_late(late: float) -> None:
    """A second of a bin on the wrong side made it `unknown`: two levels in time, beside those of the plug."""
    accelerometer, gyroscope, events = plugged(late)
    (found,) = diagnose(accelerometer, gyroscope, events).findings
    assert found.effect == "gyro_charging_bias"
    step = found.parameters["step"]
    assert np.allclose(step.value, [1.5e-3, -1e-3, 2e-3], atol=1e-4)


def test_bins_end_before_a_plug_may_have_come_and_begin_after_its_event() -> None:
    """All bins are kept, and all of them but the seconds in which the plug may have come."""
    accelerometer, gyroscope, events = plugged(0.0)
    bins, all_of_it = cut(accelerometer, gyroscope, events), cut(accelerometer, gyroscope)
    assert len(bins) == len(all_of_it)
    assert all_of_it.duration.sum() - bins.duration.sum() < len(SWITCHES) * 10.0
    assert bins.charging is not None and set(bins.charging) == {0.0, 1.0}
    starts, ends = bins.t - bins.duration / 2.0, bins.t + bins.duration / 2.0
    for s in SWITCHES:
        assert not ((starts < s) & (ends > s - 3.0)).any()


def test_an_event_that_tells_the_plug_again_cuts_nothing_off() -> None:
    """A log that told it every five seconds left no bin."""
    accelerometer, gyroscope, events = plugged(0.0)
    again = [Charging(t, bool(np.searchsorted(SWITCHES, t) % 2)) for t in np.arange(302.5, 2400.0, 5.0)]
    bins, expected = cut(accelerometer, gyroscope, [*events, *again]), cut(accelerometer, gyroscope, events)
    assert np.array_equal(bins.t, expected.t) and np.array_equal(bins.duration, expected.duration)
    assert np.array_equal(bins.charging, expected.charging)
    assert np.array_equal(bins.charging_switches, expected.charging_switches)


@pytest.mark.parametrize(("left", "kept"), [(4, True), (3, False)])
def test_what_a_plug_leaves_of_a_bin_must_tell_its_noise(left: int, kept: bool) -> None:
    """Rests of a few seconds that no plug touches are kept, however brief."""
    edges = RestEdges(
        still=np.ones(40, dtype=np.bool_),
        runs=[(0, 2), (10, 17), (20, 30)],
        first=np.array([0.0, 10.0, 20.0]),
        last=np.array([2.0, 17.0, 30.0]),
        rest=np.arange(3),
    )
    found = edges.beside_plugs([Charging(113.4 + left, True), Charging(122.4, False)], 100.0)
    assert found.first.tolist() == ([0.0, 10.0, 23.0] if kept else [0.0, 23.0])
    assert found.last.tolist() == ([2.0, 10.0 + left, 30.0] if kept else [2.0, 30.0])
    assert found.rest.tolist() == ([0, 1, 2] if kept else [0, 2])


def test_a_rest_that_a_plug_leaves_nothing_of_has_no_number() -> None:
    """Gravity's length in a rest is the mean of its bins: of none it was no number: no turn was judged."""
    rng, pieces = np.random.default_rng(3), []
    for seconds, angle in ((30, 0.0), (7, 1.2), (30, 2.4)):
        pieces += [np.tile([np.sin(angle), 0.0, np.cos(angle)], (50 * seconds, 1)), rng.normal(size=(150, 3))]
    force = np.concatenate(pieces)
    force = 9.81 * force + rng.normal(0.0, 0.01, force.shape)
    samples = Samples.checked(Sensor.ACCELEROMETER, np.arange(len(force)) / 50.0, force)
    assert np.unique(cut(samples, None).rest).tolist() == [0, 1, 2]
    assert np.unique(cut(samples, None, [Charging(37.0, True)]).rest).tolist() == [0, 1]
