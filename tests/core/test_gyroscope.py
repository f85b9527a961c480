"""Gyroscope from rest to rest against known truth: recovery, honest intervals, refusals, robustness.

The phone's motion is analytic (a product of turns about fixed axes, rates by differentiation) and made
with scipy's rotations, so that it shares nothing with the integrator under test.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stillcal.calib_core import gyroscope
from stillcal.calib_core.codec import packed, plain, unpacked
from stillcal.calib_core.gyro_solver import Problem
from stillcal.calib_core.gyroscope import GyroscopeFit, GyroscopeSettings, Parameters
from stillcal.calib_core.model import SensorModel
from stillcal.calib_core.refusals import NotSupported
from stillcal.calib_core.rests import RestState
from stillcal.calib_core.samples import Array, Samples, Sensor
from stillcal.calib_core.turns import Turn, make_turn

G = 9.80665
ACCEL = SensorModel.identity()
REST, TURN = 2.5, 3.0
X, Y, Z = np.eye(3)


@dataclass(frozen=True)
class Phone:
    """raw rate = inv(scale) rate + bias + sensitivity force + noise; the accelerometer is true but noisy.

    Densities per sqrt(Hz). wander: rad/s, step of the bias between rests.
    """

    scale: Array
    bias: Array
    sensitivity: Array
    rate_hz: float = 50.0
    density: float = np.radians(0.005)
    force_density: float = 200e-6 * G
    wander: float = 0.0


@dataclass(frozen=True)
class Recording:
    """What the phone went through: rests and the turns between them."""

    phone: Phone
    rests: list[RestState]
    turns: list[Turn]

    def fit(self, **options: object) -> GyroscopeFit:
        return gyroscope.fit(self.turns, ACCEL, G, **options)  # type: ignore[arg-type]

    def z(self, fitted: GyroscopeFit) -> Array:
        """Errors of the scale in stated standard uncertainties."""
        return ((fitted.model.scale - self.phone.scale) / fitted.scale_uncertainty).ravel()


def some_phone(rng: np.random.Generator, **changes: object) -> Phone:
    """Up to 5 % scale error, 2 % misalignment, 0.2 rad/s bias."""
    scale = rng.uniform(-0.02, 0.02, (3, 3))
    np.fill_diagonal(scale, rng.uniform(0.95, 1.05, 3))
    return replace(Phone(scale, rng.uniform(-0.2, 0.2, 3), np.zeros((3, 3))), **changes)  # type: ignore[arg-type]


def turning(s: Array, axes: Array, angle: float, wobbles: Array) -> tuple[Rotation, Array]:
    """Attitude along a turn, s in 0..1, and body rates (n, 3): `angle` about axes[0], then wobbles."""
    angles = [angle * s**3 * (10 - 15 * s + 6 * s * s)]
    speeds = [angle * 30 * s**2 * (1 - s) ** 2 / TURN]
    for cycles, size in zip((2.0, 4.5, 9.0), wobbles, strict=True):
        w = 2 * np.pi * cycles
        angles.append(size * np.sin(np.pi * s) ** 2 * np.sin(w * s))
        slope = np.pi * np.sin(2 * np.pi * s) * np.sin(w * s) + np.sin(np.pi * s) ** 2 * w * np.cos(w * s)
        speeds.append(size * slope / TURN)
    attitude, rates = Rotation.identity(s.size), np.zeros((s.size, 3))
    for axis, q, speed in zip(axes, angles, speeds, strict=True):
        part = Rotation.from_rotvec(q[:, None] * axis)
        rates = part.inv().apply(rates) + speed[:, None] * axis
        attitude = attitude * part
    return attitude, rates


def recorded(
    rng: np.random.Generator,
    phone: Phone,
    n: int = 20,
    about: Sequence[Array] | None = None,
    start: Rotation | None = None,
    wobble: float = 1.0,
) -> Recording:
    """Rest and turn, n turns. about: axes to turn about, in order, again and again; else at random."""
    at = Rotation.random(random_state=rng) if start is None else start
    s = np.arange(round(TURN * phone.rate_hz)) / round(TURN * phone.rate_hz)
    still = np.zeros((round(REST * phone.rate_hz), 3))
    rates, up = [], []
    for k in range(n + 1):
        rates.append(still)
        up.append(still + at.inv().apply([0, 0, 1]))
        axes = rng.normal(size=(4, 3))
        axes /= np.linalg.norm(axes, axis=1, keepdims=True)
        if about is not None:
            axes[0] = about[k % len(about)]
        angle = rng.uniform(0.8, 3.0)
        path, w = turning(s, axes, angle, wobble * rng.normal(size=3) * (0.3, 0.1, 0.04))
        rates.append(w)
        up.append((at * path).inv().apply([0, 0, 1]))
        at = at * Rotation.from_rotvec(angle * axes[0])
    return sensed(rng, phone, rates[:-1], up[:-1])


def sensed(rng: np.random.Generator, phone: Phone, rates: list[Array], up: list[Array]) -> Recording:
    """Pass rates and gravity, alternately of rests and turns, through the phone's sensors."""
    walk = np.cumsum(rng.normal(size=(len(rates), 3)), axis=0) * phone.wander / np.sqrt(2)
    ideal = np.concatenate([w @ np.linalg.inv(phone.scale).T + b for w, b in zip(rates, walk, strict=True)])
    force = np.concatenate(up) * G
    sd, force_sd = phone.density * np.sqrt(phone.rate_hz), phone.force_density * np.sqrt(phone.rate_hz)
    raw = ideal + phone.bias + force @ phone.sensitivity.T + rng.normal(size=ideal.shape) * sd
    measured = force + rng.normal(size=force.shape) * force_sd
    gyro = Samples.checked(Sensor.GYROSCOPE, np.arange(len(raw)) / phone.rate_hz, raw)
    edges = np.cumsum([0, *(len(w) for w in rates)])
    rests = []
    for first, last in zip(edges[0::2], edges[1::2], strict=True):
        span, n = slice(first, last), last - first
        rests.append(
            RestState(
                t_start=float(gyro.t[first]),
                t_end=float(gyro.t[last - 1]),
                n=int(n),
                specific_force=measured[span].mean(axis=0),
                force_sd=np.full(3, force_sd),
                force_uncertainty=np.full(3, force_sd / np.sqrt(n)),
                level=force_sd,
                rate=raw[span].mean(axis=0),
                rate_sd=np.full(3, sd),
                rate_uncertainty=np.full(3, sd / np.sqrt(n)),
            )
        )
    cut = [make_turn(a, b, gyro) for a, b in pairwise(rests)]
    return Recording(phone, rests, [turn for turn in cut if isinstance(turn, Turn)])


def recording(seed: int, n: int = 20, **changes: object) -> Recording:
    rng = np.random.default_rng(seed)
    return recorded(rng, some_phone(rng, **changes), n)


@pytest.mark.parametrize("rate_hz", [25.0, 50.0, 100.0, 200.0])
def test_truth_is_recovered_within_stated_uncertainties(rate_hz: float) -> None:
    trip = recording(1, n=30, rate_hz=rate_hz)
    fitted = trip.fit()
    assert fitted.parameters is Parameters.FULL9
    assert fitted.missing == ()
    assert fitted.rejected == ()
    assert np.abs(trip.z(fitted)).max() < 4.0
    assert np.abs(fitted.model.scale - trip.phone.scale).max() < 5e-4
    bias_sd = np.sqrt(np.diag(fitted.covariance)[9:])
    assert (np.abs(fitted.model.bias - trip.phone.bias) < 4.0 * bias_sd).all()
    assert fitted.rms_after < fitted.rms_before / 50
    assert fitted.gravity_rms_after == pytest.approx(G * fitted.rms_after)


def coverage(seeds: range, n: int, **changes: object) -> tuple[float, float]:
    """Share of scale elements and of biases whose 95 % interval holds the truth."""
    inside, bias_inside = [], []
    for seed in seeds:
        trip = recording(seed, n, **changes)
        fitted = trip.fit()
        inside.append(np.abs(trip.z(fitted)) < 1.96)
        sd = np.sqrt(np.diag(fitted.covariance)[9:])
        bias_inside.append(np.abs(fitted.model.bias - trip.phone.bias) < 1.96 * sd)
    return float(np.mean(inside)), float(np.mean(bias_inside))


def test_intervals_hold_the_truth_as_often_as_they_say() -> None:
    """80 phones, 720 scale elements, 240 biases: two standard errors are 0.016 and 0.028 about 0.95."""
    scale, bias = coverage(range(100, 180), n=16)
    assert 0.93 <= scale <= 0.98
    assert 0.91 <= bias <= 0.99


def test_intervals_hold_with_g_sensitivity_and_wandering_bias() -> None:
    """60 phones whose bias follows force (0.1 deg/s per g) and walks 2e-4 rad/s from rest to rest."""
    sensitivity = np.random.default_rng(7).normal(size=(3, 3)) * 1.8e-4
    scale, _ = coverage(range(200, 260), n=20, sensitivity=sensitivity, wander=2e-4)
    assert 0.92 <= scale <= 0.985


def test_g_sensitivity_is_found_and_taken_off() -> None:
    sensitivity = np.random.default_rng(8).normal(size=(3, 3)) * 1.8e-4
    trip = recording(9, n=30, sensitivity=sensitivity)
    fitted = trip.fit()
    z = (fitted.g_sensitivity - sensitivity) / fitted.g_sensitivity_uncertainty
    assert np.abs(z).max() < 4.0
    assert np.abs(trip.z(fitted)).max() < 4.0
    blind = trip.fit(settings=GyroscopeSettings(g_sensitivity=1e-9))
    assert fitted.rms_after < blind.rms_after / 2


@pytest.mark.parametrize("gross", [0.8, 0.87, 1.15, 1.31])
def test_a_grossly_wrong_nominal_scale_is_found(gross: float) -> None:
    rng = np.random.default_rng(10)
    phone = some_phone(rng)
    trip = recorded(rng, replace(phone, scale=gross * phone.scale), 24)
    fitted = trip.fit()
    assert np.abs(trip.z(fitted)).max() < 4.5
    assert fitted.iterations < 20


@pytest.mark.parametrize("bad", [0, 7, 13])
def test_one_bad_turn_is_left_out(bad: int) -> None:
    """The phone was turned by 0.2 rad while the gyroscope was clipped: gravity arrives elsewhere."""
    trip = recording(11, n=20)
    turn = trip.turns[bad]
    clipped = replace(turn, rates=np.clip(turn.rates, *np.quantile(turn.rates, (0.1, 0.9), axis=0)))
    spoilt = [*trip.turns[:bad], clipped, *trip.turns[bad + 1 :]]
    fitted = replace(trip, turns=spoilt).fit()
    assert fitted.rejected == (bad,)
    assert np.abs(trip.z(fitted)).max() < 4.5
    assert fitted.rms_after < 1e-3


def test_coning_at_25_hz_leaves_nothing_of_its_own() -> None:
    """Without noise the integrator's own error is left: below a tenth of a real gyroscope's noise."""
    trip = recording(12, n=20, rate_hz=25.0, density=1e-9, force_density=1e-9)
    fitted = trip.fit()
    assert fitted.rms_after < 3e-5
    assert np.abs(fitted.model.scale - trip.phone.scale).max() < 2e-5


def test_slopes_agree_with_numeric_differences() -> None:
    trip = recording(13, n=6, rate_hz=200.0, sensitivity=np.full((3, 3), 1e-4))
    problem = Problem.of(trip.turns, ACCEL, GyroscopeSettings())
    theta = np.concatenate((trip.phone.scale.ravel(), (1e-3, -2e-3, 1e-3)))
    slopes = problem.at(theta, 0.0).slopes
    for i in range(12):
        step = np.zeros(12)
        step[i] = 1e-6
        ahead, behind = (problem.at(theta + d, 0.0).carried.residuals for d in (step, -step))
        np.testing.assert_allclose(slopes[..., i], (ahead - behind) / 2e-6, atol=1e-3)


def test_the_frame_is_the_accelerometers() -> None:
    """An accelerometer model turned by Q turns the gyroscope's by Q: only together do they mean anything."""
    trip = recording(14, n=16)
    q = Rotation.from_rotvec([0.02, -0.01, 0.015]).as_matrix()
    turned = gyroscope.fit(trip.turns, SensorModel.of(q, np.zeros(3)), G)
    np.testing.assert_allclose(turned.model.scale, q @ trip.fit().model.scale, atol=1e-6)


def test_the_order_of_turns_does_not_matter() -> None:
    trip = recording(15, n=16)
    backwards = gyroscope.fit(trip.turns[::-1], ACCEL, G)
    np.testing.assert_allclose(backwards.model.scale, trip.fit().model.scale, atol=1e-9)


def test_held_out_turns_are_judged_like_fitted_ones() -> None:
    trip = recording(16, n=40)
    fitted = trip.fit()
    np.testing.assert_allclose(
        gyroscope.residuals(trip.turns, ACCEL, fitted.model.scale, fitted.shift), fitted.after, atol=2e-6
    )
    half = gyroscope.fit(trip.turns[::2], ACCEL, G)
    held_out = gyroscope.residuals(trip.turns[1::2], ACCEL, half.model.scale, half.shift)
    degrees = 1.0 - 12 / (2 * len(half.after))
    assert np.sqrt(np.mean(held_out**2)) < 1.3 * half.rms_after / np.sqrt(degrees)


@pytest.mark.parametrize(
    ("about", "named"), [((X,), "yz"), ((X, Y), "z"), ((Z,), "xy")], ids=["x only", "x and y", "z only"]
)
def test_axes_never_turned_about_are_named(about: Sequence[Array], named: str) -> None:
    rng = np.random.default_rng(17)
    trip = recorded(
        rng, some_phone(rng), 12, about=about, start=Rotation.from_rotvec([0.7, 0.5, 0.3]), wobble=0.0
    )
    with pytest.raises(NotSupported) as refusal:
        trip.fit(parameters=Parameters.FULL9)
    assert [m[len("a few turns about ")] for m in refusal.value.missing] == list(named)
    fitted = trip.fit()
    assert fitted.parameters is Parameters.BIAS
    assert fitted.missing == refusal.value.missing
    np.testing.assert_array_equal(fitted.model.scale, np.eye(3))


def test_turning_about_the_vertical_shows_no_scale_of_that_axis() -> None:
    """x and y turned while level, z only while upright: gravity never saw z turn."""
    rng = np.random.default_rng(18)
    phone = some_phone(rng, scale=np.eye(3))
    level = recorded(rng, phone, 14, about=(X, Y), start=Rotation.identity(), wobble=0.0)
    upright = recorded(rng, phone, 8, about=(Z,), start=Rotation.identity(), wobble=0.0)
    with pytest.raises(NotSupported, match="turns about z with z level"):
        gyroscope.fit([*level.turns, *upright.turns], ACCEL, G, parameters=Parameters.FULL9)


def test_the_largest_supported_model_is_taken() -> None:
    few = recording(19, n=4)
    fitted = few.fit()
    assert fitted.parameters in {Parameters.SCALE3, Parameters.BIAS}
    assert fitted.missing
    with pytest.raises(NotSupported):
        few.fit(parameters=Parameters.FULL9)


@pytest.mark.parametrize("n", [1, 2, 3])
def test_a_few_turns_give_a_bias_and_say_what_is_missing(n: int) -> None:
    fitted = recording(22, n=n).fit()
    assert fitted.missing
    assert np.isfinite(fitted.model.bias).all()


def test_rests_that_claim_no_noise_do_not_break_the_fit() -> None:
    """Coarse steps can make a rest's samples all alike: its claimed uncertainty is then zero."""
    trip = recording(23, n=16, density=1e-9, force_density=1e-9)
    none = np.zeros(3)

    def silent(rest: RestState) -> RestState:
        return replace(rest, force_uncertainty=none, rate_uncertainty=none, force_sd=none, rate_sd=none)

    turns = [replace(turn, before=silent(turn.before), after=silent(turn.after)) for turn in trip.turns]
    np.testing.assert_allclose(gyroscope.fit(turns, ACCEL, G).model.scale, trip.phone.scale, atol=2e-5)


def test_a_gyroscope_that_measures_nothing_is_refused() -> None:
    trip = recording(24, n=16)
    dead = [replace(turn, rates=turn.rates * 0.02 + trip.phone.bias) for turn in trip.turns]
    with pytest.raises(NotSupported):
        gyroscope.fit(dead, ACCEL, G, parameters=Parameters.FULL9)


def test_without_turns_there_is_the_bias() -> None:
    trip = recording(20, n=5)
    fitted = gyroscope.fit([], ACCEL, G, rests=trip.rests)
    assert fitted.parameters is Parameters.BIAS
    assert len(fitted.missing) == 3
    np.testing.assert_allclose(fitted.model.bias, trip.phone.bias, atol=3e-4)
    with pytest.raises(NotSupported, match="no turn"):
        gyroscope.fit([], ACCEL, G, rests=trip.rests, parameters=Parameters.SCALE3)
    with pytest.raises(NotSupported, match="gyroscope"):
        gyroscope.fit([], ACCEL, G, rests=[replace(trip.rests[0], rate=None)])


def test_turns_and_fits_survive_storing() -> None:
    trip = recording(21, n=12)
    again = [unpacked(packed(turn), Turn) for turn in trip.turns]
    fitted = gyroscope.fit(again, ACCEL, G)
    assert plain(fitted) == plain(trip.fit())
    assert plain(unpacked(packed(fitted), GyroscopeFit)) == plain(fitted)


@pytest.mark.parametrize(
    "change", [{"nominal_error": 0.0}, {"outlier": 1.0}, {"max_iterations": 0}, {"bias_shift": -1.0}]
)
def test_settings_out_of_range_are_refused(change: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(change))):
        GyroscopeSettings(**change)  # type: ignore[arg-type]
