"""Gains that change with what the catalogue has no name for are called unknown, and say what they follow."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.diagnosis.diagnose import examine
from stillcal.calib_core.diagnosis.effects.catalogue import effects_of
from stillcal.calib_core.diagnosis.model.records import Finding
from stillcal.calib_core.diagnosis.model.residuals import fit_baseline, rest_courses
from stillcal.calib_core.diagnosis.model.rotation_alignment import Aligned, Unsteady, _carried, aligned
from stillcal.calib_core.diagnosis.model.sensor_residuals import by_sensor
from stillcal.calib_core.diagnosis.segments.static_bins import Bins, cut
from stillcal.calib_core.diagnosis.segments.turns import cuts
from stillcal.calib_core.diagnosis.slow.estimate import estimate
from stillcal.calib_core.diagnosis.slow.turns.turn_residuals import (
    WAVES,
    _unforeseen,
    _waves,
    known_variances,
    turn_residuals,
    turn_view,
)
from stillcal.calib_core.streams.samples import Samples
from tests.calib_core.diagnosis.model.test_rotation_alignment import RATE, G, day
from tests.calib_core.diagnosis.slow.test_findings import day_of
from tests.calib_core.diagnosis.slow.test_off_catalogue import QUIET
from tests.support.diagnosis import nulls
from tests.support.diagnosis.said import slow_findings, turn_findings
from tests.support.diagnosis.turning import lively


def accelerometer(crossed: float, ageing: float, scale: float) -> list[Finding]:
    """A day in which y gains 1/K times what x feels, all axes age, and z's scale follows temperature."""
    rng, lived = day_of(4)
    warm = lived.temperature - lived.temperature.mean()
    error = ageing * G * lived.up * (lived.t / lived.t[-1])[:, None]
    error[:, 1] += crossed * G * warm * lived.up[:, 0]
    error[:, 2] += scale * G * warm * lived.up[:, 2]
    return slow_findings(by_sensor(nulls.bins_of(rng, lived, QUIET, accel_error=error), nulls.G)[0])


def test_what_an_axis_takes_up_of_another_by_temperature_is_no_scale() -> None:
    found = accelerometer(2e-4, 0.0, 0.0)
    assert [(f.effect, f.where.driver) for f in found] == [("unknown", "temperature x another axis' force")]
    assert found[0].axes == ["x"], "x with y"
    np.testing.assert_allclose(found[0].parameters["slope"].value, [2e-4, 0, 0], atol=4e-5)


def test_a_gain_that_ages_is_no_temperature_s() -> None:
    found = accelerometer(0.0, 2e-3, 0.0)
    assert [(f.effect, f.where.driver) for f in found] == [("unknown", "own force, with time")]
    np.testing.assert_allclose(found[0].parameters["gain"].value, 2e-3, rtol=0.2)


@pytest.mark.slow
def test_a_scale_that_follows_temperature_keeps_its_name() -> None:
    assert [f.effect for f in accelerometer(0.0, 0.0, 2e-4)] == ["accel_scale_temperature"]


@pytest.mark.parametrize(
    ("name", "driver"),
    [
        ("ageing", "time x rate of turn"),
        ("changed", "rate of turn from a moment on"),
        ("lopsided", "size of the rate of turn"),
        ("none", ""),
    ],
)
def test_turns_tell_gains_by_time_and_by_sense(name: str, driver: str) -> None:
    force, spin, _ = day()
    turning = np.linalg.norm(spin.xyz, axis=1) > 0.05
    rate = np.where(turning[:, None], spin.xyz - 0.005, 0.0)
    error = {
        "ageing": 0.01 * rate * (spin.t / spin.t[-1])[:, None],
        "changed": 0.01 * rate * (spin.t > 0.4 * spin.t[-1])[:, None],
        "lopsided": 0.01 * np.abs(rate),
        "none": 0.0 * rate,
    }[name]
    gyroscope = replace(spin, xyz=spin.xyz + error)
    bins = cut(force, gyroscope)
    found = turn_findings(aligned(gyroscope, bins, G), bins, G)
    assert [(f.effect, f.where.driver) for f in found] == ([("unknown", driver)] if driver else [])
    for f in found:
        low, high = np.moveaxis(np.array(f.parameters["gain"].ci95), -1, 0)
        np.testing.assert_allclose(f.parameters["gain"].value, 0.01, atol=0.004)
        # Of the rate as read, which is up to 2 % off, and without what is slower than 0.05 rad/s.
        assert ((low < 0.0103) & (high > 0.0097)).sum() >= 2


@pytest.mark.parametrize("changed", [0.0, 0.01])
def test_what_is_known_of_a_nuisance_leaves_room_for_a_gain_in_few_turns(changed: float) -> None:
    """Of 34 residuals, waves that hardly move anything took 24: no gain was looked for."""
    force, spin, _ = day(3, 20)
    gain = 1.0 + changed * (spin.t > 0.45 * spin.t[-1])
    gyroscope = replace(spin, xyz=spin.xyz * gain[:, None])
    bins = cut(force, gyroscope)
    made = aligned(gyroscope, bins, G)
    view = turn_view(made, bins)
    n = view.y.size
    assert n < 40 and n - 18 < view.free() < n - 9, "at most 9 for the accelerometer, and 9 of the gyroscope"
    assert replace(view, absorbed=1e9 * np.eye(n)[:, :12]).free() == pytest.approx(n - 9 - 12)
    found = turn_findings(made, bins, G)
    assert [f.where.driver for f in found] == ["rate of turn from a moment on"] * bool(changed)


def test_turns_that_reach_a_limit_tell_nothing_of_linearity() -> None:
    force, spin, _ = day()
    stop = float(np.quantile(np.abs(spin.xyz), 0.995))
    clipped = replace(spin, xyz=np.clip(spin.xyz, -stop, stop))
    bins = cut(force, clipped)
    whole, free = cuts(clipped, bins), cuts(clipped, bins, stop)
    reached = [c for c in whole if np.abs(c.rate).max() > stop - 0.01]
    assert len(reached) >= 1 and len(free) == len(whole) - len(reached)


def test_what_coarse_steps_do_to_the_bias_at_rest_is_no_gain_by_sense() -> None:
    """Steps of 1 deg/s: at rest they hide up to half of one, which shows when turns dither them."""
    force, spin, _ = day()
    step = float(np.deg2rad(1.0))
    coarse = replace(spin, xyz=step * np.round((spin.xyz + 0.3 * step) / step))
    bins = cut(force, coarse)
    assert turn_findings(aligned(coarse, bins, G), bins, G) == []


def test_waves_together_are_a_walk_about_its_mean() -> None:
    t = np.linspace(3.0, 53.0, 201)
    waves = _waves(t)
    s = (t - 3.0) / 50.0
    walk = 1.0 / 3.0 - np.maximum(s, s[:, None]) + (s**2 + s[:, None] ** 2) / 2.0
    np.testing.assert_allclose(waves @ waves.T, 6.0 * walk, atol=0.15)
    away = waves @ waves.T - 6.0 * walk
    assert np.sqrt((away**2).mean()) < 0.03


def walking(density: float) -> tuple[Samples, Samples]:
    """Return a day whose accelerometer's bias walks by so much, m/s^2/sqrt(s)."""
    force, spin, _ = day()
    steps = np.random.default_rng(7).normal(0.0, density * np.sqrt(1.0 / RATE), force.xyz.shape)
    return replace(force, xyz=force.xyz + np.cumsum(steps, axis=0)), spin


def missed_by_course(spin: Samples, bins: Bins, made: Aligned, course: Array) -> Array:
    """Return what turns miss more, rad, where the accelerometer's bias moves by `course` (n, 3), m/s^2."""
    found, steady = cuts(spin, bins), rest_courses(bins.force, bins.rest)
    x = made.baseline.parameters
    before, after = (
        np.concatenate([t.across() @ t.miss for t in _carried(found, moved, x, made.mapping)])
        for moved in (steady, steady + course)
    )
    return np.asarray(after - before)


def test_what_a_wandering_bias_does_to_turns_is_in_their_noise() -> None:
    """A bias that moves by two waves, put into the rests alone: all other things stay as they are."""
    force, spin = walking(3e-3)
    bins = cut(force, spin)
    made = replace(aligned(spin, bins, G), unsteady=Unsteady(wander=0.03))
    course = 0.02 * np.cos(np.pi * (bins.t - bins.t[0]) / np.ptp(bins.t))[:, None] * [1.0, -0.5, 0.0]
    course[:, 2] = 0.01 * np.cos(3.0 * np.pi * (bins.t - bins.t[0]) / np.ptp(bins.t))
    more = missed_by_course(spin, bins, made, course)
    absorbed = turn_view(made, bins).absorbed
    assert absorbed is not None and absorbed.shape[1] >= 10 + 3 * WAVES
    waves = absorbed[:, 10 : 10 + 3 * WAVES]
    sizes = np.linalg.lstsq(waves, more, rcond=None)[0]
    assert np.linalg.norm(more - waves @ sizes) < 0.1 * np.linalg.norm(more)
    assert 0.3 < np.sqrt((sizes**2).sum()) < 3.0, "a course of 0.02 m/s^2 where 0.03 are usual"


def test_a_bias_that_moves_by_one_standard_deviation_of_a_wave_is_one_there() -> None:
    force, spin = walking(3e-3)
    bins = cut(force, spin)
    made = replace(aligned(spin, bins, G), unsteady=Unsteady(wander=0.03))
    middles = np.array([t.end - t.duration / 2.0 for t in made.turns])
    phase = np.clip((bins.t - middles.min()) / np.ptp(middles), 0.0, 1.0)
    course = 0.03 * np.sqrt(12.0) / np.pi * np.cos(np.pi * phase)[:, None] * [1.0, 0.0, 0.0]
    more = missed_by_course(spin, bins, made, course)
    absorbed = turn_view(made, bins).absorbed
    assert absorbed is not None
    wave = absorbed[:, 10]
    assert abs(wave @ more) / (wave @ wave) == pytest.approx(1.0, abs=0.05)


def test_what_a_rest_has_anew_is_in_the_turns_before_and_after_it() -> None:
    force, spin = walking(0.0)
    bins = cut(force, spin)
    made = replace(aligned(spin, bins, G), unsteady=Unsteady(scatter=0.02))
    (rests,) = turn_view(made, bins).shared
    met = np.unique(bins.rest)
    for rest in (3, 17, met.size - 1):
        course = np.where(bins.rest[:, None] == rest, [0.02, -0.04, 0.0], 0.0)
        more = missed_by_course(spin, bins, made, course)
        own = rests[:, 3 * rest : 3 * rest + 3]
        assert (np.abs(more) > 1e-4).sum() == 2 * (2 if rest < met.size - 1 else 1)
        np.testing.assert_allclose(own @ [1.0, -2.0, 0.0], -more, atol=0.03 * np.abs(more).max())


def test_what_is_known_of_the_noise_of_a_turn() -> None:
    """Noise of 1e-3 rad/s and 0.01 m/s^2 at 50 Hz; then a bias that changes by 2e-3 rad/s; then a tilt."""
    force, spin = walking(0.0)
    bins = cut(force, spin)
    made = aligned(spin, bins, G)
    steady = replace(bins, force=rest_courses(bins.force, bins.rest), rate=np.zeros_like(bins.force))
    lasts = np.array([t.duration for t in made.turns])
    assert np.mean(known_variances(made, steady) / (1e-6 / RATE * lasts)) == pytest.approx(1.0, abs=0.1)
    changing = replace(steady, rate=np.where(bins.rest[:, None] % 2 == 1, 2e-3, 0.0) * np.ones(3))
    apart = np.array([np.ptp(changing.rate[t.first : t.first + 2]) > 0.0 for t in made.turns])
    more = known_variances(made, changing) - known_variances(made, steady)
    np.testing.assert_allclose(more, np.where(apart, (1e-3 * lasts) ** 2, 0.0), atol=1e-12)
    last = made.turns[5].first
    across = np.cross(made.baseline.up[last], [0.3, 0.5, 0.8])
    tilted = steady.force.copy()
    tilted[last] += 0.05 * across / np.linalg.norm(across)
    crept = known_variances(made, replace(steady, force=tilted)) - known_variances(made, steady)
    assert crept[5] == pytest.approx((0.05 / G) ** 2, rel=0.1)
    assert (crept > 1e-9).sum() == 1


def test_a_rest_has_the_noise_of_its_samples() -> None:
    force, spin = walking(0.0)
    bins = cut(force, spin)
    made = aligned(spin, bins, G)
    (rests,) = turn_view(made, bins).shared
    samples = RATE * float(bins.duration[bins.rest == 7].sum())
    course = np.where(bins.rest[:, None] == 7, [0.01 / np.sqrt(samples), 0.0, 0.0], 0.0)
    more = missed_by_course(spin, bins, made, course)
    np.testing.assert_allclose(rests[:, 21], -more, atol=0.2 * np.abs(more).max())


def test_turns_are_judged_where_the_norm_alone_has_the_accelerometer() -> None:
    """The fit of both goes through few turns, and what it leaves of them says nothing of their noise."""
    force, spin, _ = day(3, 14)
    bins = cut(force, spin)
    made = aligned(spin, bins, G)
    alone = fit_baseline(bins.force, bins.force_variance, bins.rest, G).parameters
    assert np.abs(made.away).max() > 1e-3
    np.testing.assert_allclose(
        made.baseline.parameters + made.away, alone, atol=0.1 * np.abs(made.away).max()
    )
    turns = _carried(cuts(spin, bins), rest_courses(bins.force, bins.rest), alone, made.mapping)
    missed = np.concatenate([t.across() @ t.miss for t in turns])
    np.testing.assert_allclose(turn_view(made, bins).y[0], missed, atol=0.05 * np.abs(missed).max())


def test_what_stamps_that_jitter_do_to_turns_is_in_their_noise() -> None:
    """Stamps of 25 Hz that are off by 1 ms, of a hand that shakes."""
    off, told = [], []
    for seed in range(4):
        force, spin = lively(seed)
        bins = cut(force, spin)
        made = aligned(spin, bins, G)
        told += [1e-3 * t.by_stamps() for t in made.turns]
        late = replace(spin, t=spin.t + np.random.default_rng(seed).normal(0.0, 1e-3, spin.t.size))
        x, steady = made.baseline.parameters, rest_courses(bins.force, bins.rest)
        before, after = (_carried(cuts(s, bins), steady, x, made.mapping) for s in (spin, late))
        off += [b.across() @ b.miss - a.across() @ a.miss for a, b in zip(before, after, strict=True)]
        jittered = known_variances(replace(made, unsteady=Unsteady(jitter=1e-3)), bins)
        added = np.sqrt(jittered - known_variances(made, bins))
        np.testing.assert_allclose(added, told[-len(made.turns) :], rtol=1e-6)
    assert 0.8 < np.sqrt(np.mean(np.square(np.array(off) / np.array(told)[:, None]))) < 1.25


def test_samples_that_are_held_are_left_out_of_turns() -> None:
    """A gain of one axis that grows with time, and a nonlinearity, were made of them."""
    force, spin, _ = day(3, 20)
    fresh = np.where(np.random.default_rng(0).random(len(spin)) < 0.1, 0, np.arange(len(spin)))
    held = replace(spin, xyz=frozen(spin.xyz[np.maximum.accumulate(fresh)]))
    sizes = []
    for gyroscope in (spin, held):
        turns = examine(force, gyroscope, sought=()).turns
        assert turns is not None
        sizes.append(np.abs(_unforeseen(turns.views[0])).mean())
    assert sizes[1] < 1.3 * sizes[0]


@pytest.mark.parametrize(("density", "low", "high"), [(0.0, 0.0, 1e-3), (3e-3, 0.015, 0.06)])
def test_turns_know_how_much_the_accelerometer_wanders(density: float, low: float, high: float) -> None:
    exam = examine(*walking(density), sought=())
    assert exam.aligned is not None and low <= exam.aligned.unsteady.wander <= high


@pytest.mark.parametrize("seed", [2, 5, 7])
def test_a_little_wander_leaves_all_turns_in(seed: int) -> None:
    """Waves fitted to few turns leave rounding alone, by which turns were outliers at random."""
    force, spin, _ = day(seed, 24)
    bins = cut(force, spin)
    made = aligned(spin, bins, G)
    still, wandering = (turn_residuals(replace(made, unsteady=Unsteady(w)), bins, G) for w in (0.0, 2e-4))
    assert still is not None and wandering is not None
    assert len(wandering.turns) == len(still.turns)


@pytest.mark.parametrize("jolts", [(), (0.3,), (0.3, 0.05)])
def test_turns_that_miss_by_far_more_than_the_others_are_left_out(jolts: tuple[float, ...]) -> None:
    """The second shows where the first is out."""
    force, spin, _ = day(3, 24)
    bins = cut(force, spin)
    made = aligned(spin, bins, G)
    turns = list(made.turns)
    for k, jolt in enumerate(jolts, start=4):
        turns[k] = replace(turns[k], miss=turns[k].miss + jolt * turns[k].across()[0])
    whole, left = (turn_residuals(replace(made, turns=t), bins, G) for t in (made.turns, turns))
    assert whole is not None and left is not None
    assert [t.first for t in left.turns] == [
        t.first for t in whole.turns if t.first not in {turns[k].first for k in range(4, 4 + len(jolts))}
    ]
    assert len(whole.turns) == len(made.turns)


def test_what_a_turn_is_off_by_knows_no_scale_and_no_misalignment() -> None:
    force, spin, _ = day(3, 24)
    bins = cut(force, spin)
    view = turn_view(aligned(spin, bins, G), bins)
    scaled = replace(view, y=view.y + view.baseline @ np.linspace(-0.02, 0.02, 9))
    np.testing.assert_allclose(_unforeseen(scaled), _unforeseen(view), atol=1e-6)


def test_what_happens_between_samples_is_no_nonlinearity() -> None:
    """Its sizes, which are nothing, were off by 3 of their errors."""
    effect = next(e for e in effects_of("gyro", in_turns=True) if e.name == "gyro_nonlinearity")
    off = []
    for seed in range(10):
        force, spin = lively(seed)
        bins = cut(force, spin)
        turns = turn_residuals(aligned(spin, bins, G), bins, G)
        assert turns is not None
        found = estimate(turns, turns.hypotheses(effect)[0], ())
        off.append(found.value / found.sigma)
    assert np.sqrt(np.mean(np.square(off))) < 2.0


def test_what_samples_do_not_tell_is_in_the_variance_of_a_turn() -> None:
    """It has two components across gravity, which share its square."""
    force, spin = lively(1)
    bins = cut(force, spin)
    made = aligned(spin, bins, G)
    told, untold = (
        known_variances(replace(made, turns=[replace(t, between=b) for t in made.turns]), bins)
        for b in (np.zeros(3), np.array([0.03, 0.0, 0.04]))
    )
    np.testing.assert_allclose(untold - told, 0.05**2 / 2.0)
