"""Runs of still windows made by hand: which windows a run takes, and what rest it makes, to known values.

Noise alternates between -s and +s, so that every sum is known exactly and successive samples are as
unlike as can be; means of windows are moved by hand.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import t as student

from stillcal.calib_core.static.interval import (
    Run,
    absorb,
    contributions,
    drifted,
    rest_from_windows,
    trimmed,
)
from stillcal.calib_core.static.rest import RestState
from stillcal.calib_core.static.settings import DetectorSettings, Label
from stillcal.calib_core.static.windows import COLUMNS, K_END, Stream, paired, take
from stillcal.calib_core.streams.samples import Samples, Sensor

SETTINGS = DetectorSettings()
G = 9.80665
WINDOW, N = 0.5, 24  # s, samples in each
FINE = 2e-6
X, Y, Z = np.eye(3)


def cells(sensor, values, temperature=None):
    """Turn values (windows * N, 3) at 48 Hz into rows."""
    t = np.arange(len(values)) * (WINDOW / N)
    return take(Stream(), Samples.checked(sensor, t, values, temperature), WINDOW, close=True).rows


def noise(windows, s):
    """Noise of standard deviation `s` on each axis, (windows * N, 3), of zero mean in each window.

    It alternates, but for one small step in each window that shows how fine the sensor's codes are.
    """
    window = np.tile([s, -s], N // 2)
    window[11], window[12] = s - FINE, -s
    return np.outer(np.tile(window, windows), np.ones(3))


def still(windows, s=0.01, force=(0.0, 0.0, G), moved=None):
    """Samples of a force; moved: (windows, 3) added to each window."""
    values = noise(windows, s) + np.asarray(force, dtype=float)
    return values if moved is None else values + np.repeat(np.asarray(moved, dtype=float), N, axis=0)


def rest_of(values, rate=None, drifting=False, settings=SETTINGS, temperature=None):
    accel = cells(Sensor.ACCELEROMETER, values, temperature)
    gyro = np.zeros((0, COLUMNS)) if rate is None else cells(Sensor.GYROSCOPE, rate)
    return rest_from_windows(paired(accel, gyro), drifting, settings)


def made(*arguments, **options) -> RestState:
    found = rest_of(*arguments, **options)
    assert isinstance(found, RestState), found
    return found


# When a run is a rest


@pytest.mark.parametrize(("windows", "drifting", "short"), [(4, False, 3), (10, True, 9)])
def test_a_rest_lasts_as_long_as_asked_and_longer_where_it_drifted_off(windows, drifting, short):
    settings = DetectorSettings(w_min_s=2.0, settle_s=5.0)
    made(still(windows), drifting=drifting, settings=settings)
    label = Label.TILTING if drifting else Label.SHORT
    assert rest_of(still(short), drifting=drifting, settings=settings) is label


@pytest.mark.parametrize(("alive", "frozen"), [(2, False), (1, True)])
def test_nine_windows_in_ten_may_repeat_themselves(alive, frozen):
    values = np.tile([0.0, 0.0, G], (20 * N, 1))
    values[: alive * N] += noise(alive, 0.01)
    assert (rest_of(values) is Label.FROZEN) == frozen


@pytest.mark.parametrize(("with_rate", "known"), [(5, True), (4, False)])
def test_half_of_the_windows_with_a_gyroscope_tell_the_rate(with_rate, known):
    rest = made(still(10), rate=still(10, 1e-3, (0.1, 0.2, 0.3))[: with_rate * N])
    assert (rest.rate is not None) == (rest.undetected_rotation_bound is not None) == known


# What it says


def test_every_figure_is_that_of_the_samples():
    moved = 0.001 * np.array([X, -X, Y, -Y, Z, -Z])
    values = still(6, 0.01, (3.0, 4.0, 8.0), moved)
    warm = np.linspace(20.0, 26.0, len(values))
    rest = made(values, rate=still(6, 1e-3, (0.1, -0.2, 0.3)), temperature=warm)
    freedom = 6 * N / (6 * N - 6)
    assert (rest.t_start, rest.n) == (0.0, 6 * N)
    assert rest.t_end == pytest.approx(6 * WINDOW - WINDOW / N)
    np.testing.assert_allclose(rest.specific_force, values.mean(axis=0), rtol=1e-12)
    np.testing.assert_allclose(rest.force_sd, 0.01 * np.sqrt(freedom), rtol=1e-4)
    np.testing.assert_allclose(rest.rate, [0.1, -0.2, 0.3], atol=FINE)
    np.testing.assert_allclose(rest.rate_sd, 1e-3 * np.sqrt(freedom), rtol=1e-3)
    assert rest.rate_level == pytest.approx(1e-3 * np.sqrt(freedom), rel=1e-3)
    assert rest.temperature == pytest.approx(23.0)
    norms = np.linalg.norm(values, axis=1).reshape(6, N)
    assert rest.level == pytest.approx(
        np.sqrt(((norms - norms.mean(axis=1)[:, None]) ** 2).sum() / (5 * N + 18))
    )
    assert made(values).temperature is None


@pytest.mark.parametrize("windows", range(2, 12))
def test_so_few_batches_are_widened_by_students_t(windows):
    """Windows alternately d above and below, along gravity: the mean's variance is d^2 / (k - 1).

    Student's t by scipy, for a probability of 68.27 %.
    """
    d = 0.002
    moved = d * np.array([(-1.0) ** k for k in range(windows)])[:, None] * Z
    expected = d / np.sqrt(windows - 1) * student.ppf((1 + 0.6827) / 2, windows - 1)
    found = made(still(windows, d, moved=moved)).force_uncertainty[2]
    balance = 1 - (windows % 2) / windows**2  # an odd number is not centred
    assert found == pytest.approx(expected * np.sqrt(balance), rel=0.01)


@pytest.mark.parametrize(("windows", "batches"), [(6, 0), (7, 0), (8, 4), (9, 4), (12, 6), (16, 8)])
def test_longer_batches_count_while_four_are_left(windows, batches):
    """Two windows above, two below: pairs are as far off as windows, and only half as many."""
    d = 0.002
    moved = d * np.array([1.0, 1.0, -1.0, -1.0] * 4)[:windows, None] * np.ones(3)
    found = float(made(still(windows, d, moved=moved)).force_uncertainty[0])
    used = batches or windows
    signs = np.array([1.0, -1.0] * 8)[:used] if batches else np.array([1.0, 1.0, -1.0, -1.0] * 2)[:used]
    scatter = np.sqrt(((signs - signs.mean()) ** 2).sum() / (used * (used - 1)))
    assert found == pytest.approx(d * scatter * student.ppf((1 + 0.6827) / 2, used - 1), rel=0.01)


def test_white_noise_averages_out_over_all_samples():
    """Windows agree exactly; successive samples are as unlike as can be, which is never taken for better."""
    found = made(still(20, 0.01)).force_uncertainty
    np.testing.assert_allclose(found, 0.01 / np.sqrt(20 * N - 1), rtol=1e-3)


def test_repeated_samples_count_once():
    """Each value held twice: (1 + r) / (1 - r) times the variance, with 1 - r = steps^2 / (2 squares)."""
    held = np.tile([0.01, -0.01], N // 4)
    held[5] = 0.01 - FINE
    held[6] = -0.01
    window = np.repeat(held, 2)
    found = made(np.tile(window, 20)[:, None] + np.array([0.0, 0.0, G])).force_uncertainty
    ratio = (np.diff(window) ** 2).sum() / (2 * (window**2).sum())
    assert ratio < 1
    np.testing.assert_allclose(found, 0.01 / np.sqrt(20 * N - 1) * np.sqrt(2 / ratio - 1), rtol=1e-3)


STEP = 0.1


def test_a_quantiser_on_two_codes_leaves_a_step_over_the_root_of_twelve():
    codes = np.tile([0.0, STEP], 10 * N // 2)[:, None] * np.ones(3) + [0.0, 0.0, 98 * STEP]
    found = made(codes).force_uncertainty
    white = STEP / 2 / np.sqrt(10 * N - 1)
    np.testing.assert_allclose(found, np.hypot(white, STEP / np.sqrt(12)), rtol=1e-6)


def test_noise_over_three_codes_dithers_the_step_as_theory_says():
    """Widrow and Kollar 2008: what is left is LSB / (pi sqrt 2) exp(-2 pi^2 sd^2 / LSB^2)."""
    window = np.zeros(N)
    window[[2, 6, 10, 14]] = 1.0, -1.0, 1.0, -1.0  # a mean of nought in every window
    codes = np.tile(window, 10)
    before_rounding = 4 / (N - 1) - 1 / 12 - 0.05
    left = STEP / (np.pi * np.sqrt(2)) * np.exp(-2 * np.pi**2 * before_rounding)
    found = made(STEP * codes[:, None] * np.ones(3) + [0.0, 0.0, 98 * STEP]).force_uncertainty
    white = STEP * np.sqrt(40) / np.sqrt(10 * N - 1) / np.sqrt(10 * N)
    np.testing.assert_allclose(found, np.hypot(white, left), rtol=1e-6)
    assert 3 * white < left < 0.6 * STEP / (np.pi * np.sqrt(2))


def test_batches_weigh_windows_by_their_samples():
    """Every second window has its first ten samples only; all have the same mean."""
    values, keep = still(12, 0.01), np.ones(12 * N, dtype=bool)
    for window in range(0, 12, 2):
        keep[window * N + 10 : (window + 1) * N] = False
    t = (np.arange(len(values)) * (WINDOW / N))[keep]
    rows = take(Stream(), Samples.checked(Sensor.ACCELEROMETER, t, values[keep]), WINDOW, close=True).rows
    rest = rest_from_windows(paired(rows, np.zeros((0, COLUMNS))), False, SETTINGS)
    assert isinstance(rest, RestState)
    np.testing.assert_allclose(rest.force_uncertainty, 0.01 / np.sqrt(keep.sum() - 1), rtol=0.01)
    np.testing.assert_allclose(rest.specific_force, [0.0, 0.0, G], atol=2e-3 * 0.01)


@pytest.mark.parametrize("sd", [0.35, 0.45])
def test_a_dithered_mean_is_off_by_what_is_admitted(sd):
    """Over all places of the truth between two codes, noise drawn anew: the bias alone, of a large mean."""
    rng, n = np.random.default_rng(3), 200_000
    truths = (np.arange(16) + 0.5) / 16
    off = [np.round(truth + rng.normal(0, sd, n)).mean() - truth for truth in truths]
    theory = 1 / (np.pi * np.sqrt(2)) * np.exp(-2 * np.pi**2 * sd**2)
    assert np.sqrt(np.mean(np.square(off))) == pytest.approx(theory, rel=0.1)


def test_an_axis_that_never_left_its_code_has_the_others_step():
    codes = np.tile([0.0, 0.0, 98 * STEP], (10 * N, 1))
    codes[::2, 0] += STEP
    codes[::2, 1] += 2 * STEP
    found = made(codes).force_uncertainty
    assert found[2] == pytest.approx(2 * STEP / np.sqrt(12), rel=1e-6)
    assert found[0] == pytest.approx(np.hypot(STEP / np.sqrt(12), STEP / 2 / np.sqrt(10 * N - 1)), rel=1e-6)


# Turning


def turning(windows, rate, s):
    t = np.arange(windows * N) * (WINDOW / N)
    t -= t.mean()
    return G * np.stack([np.sin(rate * t), np.zeros_like(t), np.cos(rate * t)], axis=1) + noise(windows, s)


def slope_uncertainty(windows, s):
    """Of a slope by least squares over the windows' middles, all three axes, in rad/s."""
    middle = (np.arange(windows) - (windows - 1) / 2) * WINDOW
    return np.sqrt(3 * s**2 * N / (N - 1) / (N * (middle**2).sum())) / G


@pytest.mark.parametrize(("rate", "turns"), [(0.00099, False), (0.00101, True), (-0.00101, True)])
def test_gravity_may_turn_by_a_milliradian_a_second(rate, turns):
    assert (rest_of(turning(20, rate, 1e-4)) is Label.TILTING) == turns


@pytest.mark.parametrize(("sigmas", "turns"), [(3.9, False), (4.1, True)])
def test_a_turn_must_exceed_four_of_its_uncertainties(sigmas, turns):
    rate = sigmas * slope_uncertainty(10, 0.3)
    assert rate > 2 * SETTINGS.max_tilt_rate
    assert (rest_of(turning(10, rate, 0.3)) is Label.TILTING) == turns


def test_the_fastest_turn_that_would_not_show_is_the_slope_and_two_uncertainties():
    s = 0.01
    rest = made(turning(20, 5e-4, s))
    assert rest.tilt_rate_limit == pytest.approx(5e-4 + 2 * slope_uncertainty(20, s), rel=0.02)


def test_windows_that_scatter_about_the_slope_make_it_uncertain():
    """Means alternately off along x: an ordinary line through them, with two degrees of freedom less."""
    k, d = 9, 0.004
    signs = np.array([(-1.0) ** i for i in range(k)])
    rest = made(still(k, 1e-4, moved=np.outer(d * signs, X)))
    middle = (np.arange(k) - (k - 1) / 2) * WINDOW
    off = d * (signs - signs.mean())
    slope = (middle * off).sum() / (middle**2).sum()
    scatter = ((off - slope * middle) ** 2).sum() / (k - 2)
    own = 1e-4**2 * N / (N - 1) / N
    uncertainty = np.sqrt((scatter + 2 * own) / (middle**2).sum()) / G
    assert rest.tilt_rate_limit == pytest.approx(abs(slope) / G + 2 * uncertainty, rel=1e-3)


def test_rounding_makes_the_slope_uncertain_too():
    """Each window's mean may be off by a step over the root of twelve, as the whole mean."""
    k = 10
    codes = np.tile([0.0, STEP], k * N // 2)[:, None] * np.ones(3) + [0.0, 0.0, 98 * STEP]
    middle = (np.arange(k) - (k - 1) / 2) * WINDOW
    own = STEP**2 / 4 * N / (N - 1) / N
    uncertainty = np.sqrt(3 * (own + STEP**2 / 12) / (middle**2).sum()) / np.linalg.norm(codes.mean(axis=0))
    assert made(codes).tilt_rate_limit == pytest.approx(2 * uncertainty, rel=1e-3)


def test_turning_about_the_vertical_is_no_tilt():
    """The norm grows: what lies along gravity is no turn."""
    values = still(20, 1e-4)
    values[:, 2] += np.linspace(-0.05, 0.05, len(values))
    rest = made(values)
    assert rest.tilt_rate_limit < 1e-3


def test_one_window_alone_bounds_no_turn():
    row = paired(cells(Sensor.ACCELEROMETER, still(1)), np.zeros((0, COLUMNS)))
    row[:, K_END] = 4.0  # a slow sensor's window of four cells
    rest = rest_from_windows(row, False, SETTINGS)
    assert isinstance(rest, RestState) and rest.tilt_rate_limit > 1e6


def test_rotation_about_the_vertical_is_bounded_by_the_rate_along_it():
    rate = still(20, 1e-3, (0.01, 0.02, 0.03))
    rest = made(still(20, force=(0.6 * G, 0.0, -0.8 * G)), rate=rate)
    own = rest.rate_uncertainty
    expected = abs(0.6 * 0.01 - 0.8 * 0.03) + 2 * np.hypot(0.6 * own[0], 0.8 * own[2])
    assert rest.undetected_rotation_bound == pytest.approx(expected)


# Gathering windows into a run


def joint(values, rate=None):
    gyro = np.zeros((0, COLUMNS)) if rate is None else cells(Sensor.GYROSCOPE, rate)
    return paired(cells(Sensor.ACCELEROMETER, values), gyro)


def taken(rows, before=10, coarse=(0.0, 0.0), settings=SETTINGS):
    """Absorb rows after the first `before` of them; return how many of the rest were taken."""
    run, n = absorb(Run(), rows[:before], contributions(rows[:before]), coarse, settings)
    assert n == before
    longer, more = absorb(run, rows[before:], contributions(rows[before:]), coarse, settings)
    assert longer.cells == before + more
    return more


def limit(s, before, factor=4.0):
    """Standard uncertainties of the difference of a window's mean and the run's, three axes together."""
    return factor * np.sqrt(3 * s**2 * N / (N - 1) * (1 / (before * N) + 1 / N))


@pytest.mark.parametrize("axis", [X, Y, -Z])
@pytest.mark.parametrize(("share", "count"), [(0.99, 2), (1.01, 0)])
def test_a_window_leaves_the_run_by_four_uncertainties_and_the_allowance(axis, share, count):
    s = 0.02
    step = share * (limit(s, 10) + SETTINGS.force_step)
    rows = joint(still(12, s, moved=np.outer([0.0] * 10 + [step, 0.0], axis)))
    assert taken(rows) == count


@pytest.mark.parametrize("noisy", [X, Y, Z])
@pytest.mark.parametrize(("share", "count"), [(0.99, 2), (1.01, 0)])
def test_noise_of_any_one_axis_counts(noisy, share, count):
    values = np.tile([0.0, 0.0, G], (12 * N, 1)) + noise(12, 0.06) * noisy
    step = share * (limit(0.06, 10) / np.sqrt(3) + SETTINGS.force_step)
    values[10 * N : 11 * N] += step * X
    assert taken(joint(values)) == count


@pytest.mark.parametrize(("share", "count"), [(0.99, 2), (1.01, 0)])
def test_correlated_noise_widens_the_line_by_the_root_of_ten_at_most(share, count):
    """Half of a window above, half below: (1 + r) / (1 - r) would be 23."""
    s = 0.02
    slow = np.tile(np.repeat([s, -s], N // 2), 12)[:, None] + np.array([0.0, 0.0, G])
    slow[10 * N : 11 * N] += share * (np.sqrt(10.0) * limit(s, 10) + SETTINGS.force_step) * X
    assert taken(joint(slow)) == count


@pytest.mark.parametrize(("share", "count"), [(0.99, 2), (1.01, 0)])
def test_a_coarse_sensor_is_allowed_four_steps_more(share, count):
    s = 0.02
    step = share * (limit(s, 10) + SETTINGS.force_step + 4 * 0.03)
    rows = joint(still(12, s, moved=np.outer([0.0] * 10 + [step, 0.0], X)))
    assert taken(rows, coarse=(0.03, 0.0)) == count
    assert taken(rows, coarse=(0.0, 0.03)) == 0


@pytest.mark.parametrize(("share", "count"), [(0.99, 2), (1.01, 0)])
def test_the_gyroscopes_mean_may_leave_no_further(share, count):
    s = 0.001
    step = share * (limit(s, 10) + SETTINGS.rate_step)
    rate = still(12, s, (0.1, 0.2, 0.3), moved=np.outer([0.0] * 10 + [step, 0.0], Y))
    assert taken(joint(still(12), rate)) == count


def test_windows_are_taken_up_to_the_first_that_leaves_either_sensor():
    force = still(20, 0.01, moved=np.outer([0.0] * 15 + [1.0] * 5, X))
    rate = still(20, 0.001, moved=np.outer([0.0] * 13 + [0.1] * 7, Y))
    assert taken(joint(force, rate)) == 3
    assert taken(joint(force)) == 5
    assert taken(joint(still(20, 0.01), rate)) == 3


def test_a_run_takes_its_first_window_whatever_it_is():
    rows = joint(still(3, moved=np.outer([5.0, 0.0, 0.0], X)))
    run, n = absorb(Run(), rows, contributions(rows), (0.0, 0.0), SETTINGS)
    assert (n, run.cells, run.rows.shape[0]) == (1, 1, 1)


MOTION = (Label.ACCEL_MOVING, Label.GYRO_MOVING, Label.STEPPED, Label.IMPLAUSIBLE)


@pytest.mark.parametrize("label", Label)
def test_windows_that_border_on_motion_are_left_out(label):
    rows = joint(still(5))
    parted = int(label in MOTION)
    assert len(trimmed(Run(rows, after=label), Label.GAP)) == 5 - parted
    assert len(trimmed(Run(rows), label)) == 5 - parted
    kept = trimmed(Run(rows, after=label), label)
    np.testing.assert_array_equal(kept, rows[parted : 5 - parted])
    assert len(trimmed(Run(rows[:1], after=label), label)) == 1 - parted
    assert drifted(Run(rows, after=label), Label.GAP) == drifted(Run(rows), label) == (label is Label.STEPPED)


def test_the_lengths_of_windows_add_up():
    rows = joint(still(3))
    rows[:, K_END] = [4.0, 8.0, 12.0]
    rows[:, 0] = [0.0, 4.0, 8.0]
    assert Run(rows).cells == 12 and Run().cells == 0
