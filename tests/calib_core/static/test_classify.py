"""Windows made by hand: on which side of each line they lie, and what a coarse sensor is allowed."""

from __future__ import annotations

import numpy as np
import pytest

from stillcal.calib_core.static.classify import (
    LABELS,
    Coarseness,
    SensorWindows,
    Windows,
    classify,
    trainable,
)
from stillcal.calib_core.static.noise_floor import Floor
from stillcal.calib_core.static.settings import DetectorSettings, Label
from stillcal.calib_core.static.windows import (
    COLUMNS,
    D2,
    GAP,
    HIGH,
    K_END,
    LOW,
    LSB,
    M2,
    MEAN,
    K,
    N,
)

SETTINGS = DetectorSettings()
G = 9.80665
UP = np.nextafter


def rows(n=1, sd=0.01, mean=(0.0, 0.0, G), samples=25, **fields):
    """Whole windows of one cell: spread exactly `sd`, gap 0.02 s, fine steps; fields: columns by index."""
    out = np.zeros((n, COLUMNS))
    out[:, K], out[:, K_END] = np.arange(n), np.arange(n) + 1
    out[:, N], out[:, GAP] = samples, 0.02
    out[:, MEAN] = mean
    out[:, M2] = np.asarray(sd)[..., None] ** 2 * max(samples - 1, 1)
    out[:, D2], out[:, LSB] = 1e-4, 1e-4
    out[:, LOW], out[:, HIGH] = -1.0, 1.0
    for name, value in fields.items():
        out[:, {"gap": GAP, "d2": D2, "lsb": LSB, "low": LOW, "high": HIGH, "k_end": K_END}[name]] = value
    return out


def quiet_gyro(n=1, **fields):
    return rows(n, sd=fields.pop("sd", 1e-3), mean=(0.01, 0.02, -0.01), **fields)


def labels(accel, gyro=None, floors=(0.01, 1e-3), coarse=False, settings=SETTINGS):
    """Judge windows against floors that are the same at every rate."""
    n = len(accel)
    known = tuple(Floor(level=np.full(9, level)) for level in floors)
    windows = Windows.of(accel, np.zeros((0, COLUMNS)) if gyro is None else gyro, np.ones(n, int), settings)
    return [LABELS[code] for code in classify(windows, known, coarse, settings)]


def one(*arguments, **knobs):
    (label,) = labels(*arguments, **knobs)
    return label


def test_a_quiet_window_is_still_with_and_without_a_gyroscope():
    assert one(rows()) is Label.STILL
    assert one(rows(), quiet_gyro()) is Label.STILL


@pytest.mark.parametrize(
    ("at_the_line", "beyond", "label"),
    [
        (rows(gap=0.3), rows(gap=UP(0.3, 1)), Label.GAP),
        (rows(samples=4), rows(samples=3), Label.SPARSE),
        (rows(mean=(0, 3, 4)), rows(mean=(0, 3 - 1e-9, 4)), Label.IMPLAUSIBLE),
        (rows(mean=(3, 0, 4)), rows(mean=(3 - 1e-9, 0, 4)), Label.IMPLAUSIBLE),
        (rows(mean=(9, 12, 0)), rows(mean=(9, 12 + 1e-9, 0)), Label.IMPLAUSIBLE),
        (rows(mean=(-9, 0, -12)), rows(mean=(-9 - 1e-9, 0, -12)), Label.IMPLAUSIBLE),
        (rows(d2=(0, 0, 1e-9), lsb=0.25), rows(d2=0), Label.FROZEN),
        (rows(sd=0.02 * (1 - 1e-9)), rows(sd=0.02 * (1 + 1e-9)), Label.ACCEL_MOVING),
    ],
)
def test_the_accelerometer_on_either_side_of_each_line(at_the_line, beyond, label):
    assert one(at_the_line) is Label.STILL
    assert one(beyond) is label


def test_whatever_the_floor_nothing_above_the_ceiling_is_still():
    unknown = (np.inf, np.inf)
    for sd, label in ((0.15, Label.STILL), (0.1501, Label.ACCEL_MOVING)):
        assert one(rows(sd=sd - 1e-9), floors=unknown) is label
    for sd, label in ((0.03, Label.STILL), (0.0301, Label.GYRO_MOVING)):
        assert one(rows(), quiet_gyro(sd=sd - 1e-9), floors=unknown) is label


def test_the_gyroscope_may_be_three_floors_and_the_accelerometer_two():
    for sd, label in ((0.003 * (1 - 1e-9), Label.STILL), (0.003 * (1 + 1e-9), Label.GYRO_MOVING)):
        assert one(rows(), quiet_gyro(sd=sd)) is label
    strict = DetectorSettings(accel_factor=1.5, gyro_factor=1.25)
    assert one(rows(sd=0.0151), settings=strict) is Label.ACCEL_MOVING
    assert one(rows(), quiet_gyro(sd=1.24e-3), settings=strict) is Label.STILL
    assert one(rows(), quiet_gyro(sd=1.26e-3), settings=strict) is Label.GYRO_MOVING


def test_the_first_of_several_reasons_is_given():
    """In the order: gap, sparse, implausible, frozen, the accelerometer moves, the gyroscope moves."""
    moving = quiet_gyro(sd=0.02)
    steps = [
        (rows(gap=1.0, samples=3, mean=(0, 0, 1), sd=0.1, d2=0), Label.GAP),
        (rows(samples=3, mean=(0, 0, 1), sd=0.1, d2=0), Label.SPARSE),
        (rows(mean=(0, 0, 1), sd=0.1, d2=0), Label.IMPLAUSIBLE),
        (rows(sd=0.1, d2=0), Label.FROZEN),
        (rows(sd=0.1), Label.ACCEL_MOVING),
        (rows(), Label.GYRO_MOVING),
    ]
    assert [one(accel, moving) for accel, _ in steps] == [label for _, label in steps]


def test_repeats_are_frozen_unless_the_sensor_is_known_to_be_coarse():
    assert one(rows(d2=0), coarse=False) is Label.FROZEN
    assert one(rows(sd=0.0, d2=0), coarse=True) is Label.STILL
    assert one(rows(), coarse=True) is Label.STILL


def test_an_axis_that_holds_one_value_while_another_shows_many_codes_is_frozen():
    """Eight steps of the quantiser, 0.125, may come of a noise that the other axes do not show."""
    one_axis = {"d2": (1e-4, 0.0, 1e-4), "lsb": (0.125, np.inf, 0.125), "low": 0.0}
    assert one(rows(**one_axis, high=UP(1.0, 2))) is Label.FROZEN
    assert one(rows(**one_axis, high=UP(1.0, 2)), coarse=True) is Label.FROZEN
    assert one(rows(**one_axis, high=1.0)) is Label.STILL
    for high, used in ((1.0, 25), (UP(1.0, 2), 0)):
        windows = Windows.of(rows(), quiet_gyro(**one_axis, high=high), np.ones(1, int), SETTINGS)
        assert windows.gyro.rows[0, N] == used


@pytest.mark.parametrize("axes", [(0, 1, 2), (1,)])
def test_half_a_step_is_allowed_on_axes_that_show_three_codes_at_most(axes):
    """Rounding to steps of 0.1: the floor and half a step add up in squares, averaged over the axes."""
    lsb = np.full(3, np.inf)
    lsb[list(axes)] = 0.1
    limit = np.sqrt(0.02**2 + 0.05**2 * len(axes) / 3)
    three_codes = {"lsb": lsb, "low": 0.0, "high": 0.25}
    assert one(rows(sd=limit * (1 - 1e-9), **three_codes)) is Label.STILL
    assert one(rows(sd=limit * (1 + 1e-9), **three_codes)) is Label.ACCEL_MOVING
    more = {"lsb": lsb, "low": 0.0, "high": UP(0.25, 1)}
    assert one(rows(sd=0.021, **more)) is Label.ACCEL_MOVING
    assert one(rows(sd=0.019, **more)) is Label.STILL


def test_an_allowance_never_lifts_the_ceiling():
    three_codes = {"lsb": 1.0, "low": 0.0, "high": 2.0}
    assert one(rows(sd=0.149, **three_codes)) is Label.STILL
    assert one(rows(sd=0.151, **three_codes)) is Label.ACCEL_MOVING


@pytest.mark.parametrize(
    ("fields", "used"),
    [
        ({"gap": 0.3}, True),
        ({"gap": UP(0.3, 1)}, False),
        ({"samples": 4}, True),
        ({"samples": 3}, False),
        ({"d2": (0, 1e-12, 0), "lsb": 0.25}, True),
        ({"d2": 0}, False),
    ],
)
def test_a_gyroscope_window_is_used_where_it_is_whole_and_alive(fields, used):
    """One that is not used says nothing, neither that the phone turns nor that it does not."""
    windows = Windows.of(rows(), quiet_gyro(sd=0.02, **fields), np.ones(1, int), SETTINGS)
    assert (windows.gyro.rows[0, N] > 0) == used
    assert one(rows(), quiet_gyro(sd=0.02, **fields)) is (Label.GYRO_MOVING if used else Label.STILL)


def test_each_window_is_judged_by_its_own_gyroscope():
    accel, gyro = rows(4), quiet_gyro(4, sd=np.array([1e-3, 0.02, 1e-3, 1e-3]))
    found = labels(accel, gyro[[0, 1, 3]])
    assert found == [Label.STILL, Label.GYRO_MOVING, Label.STILL, Label.STILL]
    windows = Windows.of(accel, gyro[[0, 1, 3]], np.ones(4, int), SETTINGS)
    assert windows.gyro.rows[:, N].tolist() == [25, 25, 0, 25]
    assert len(windows) == 4 and len(windows[1:3]) == 2
    assert windows[1:3].gyro.spread.tolist() == pytest.approx([0.02, 0.0])


@pytest.mark.parametrize(
    ("samples", "cells", "rate_class"),
    [(1, 1, 0), (2, 1, 1), (4, 1, 2), (25, 1, 4), (50, 2, 4), (31, 1, 4), (32, 1, 5), (100, 8, 3)],
)
def test_windows_are_sorted_by_octaves_of_their_rate(samples, cells, rate_class):
    """Samples over cells of half a second: 50 Hz lies in 32 to 64 Hz, the fifth octave from 2 Hz."""
    found = SensorWindows.of(rows(samples=samples, k_end=float(cells)), SETTINGS)
    assert found.rates.tolist() == [rate_class]


# What a sensor's windows teach


def test_whole_plausible_windows_teach_and_others_do_not():
    accel = np.concatenate(
        [
            rows(),
            rows(sd=0.1),
            rows(gap=1.0),
            rows(samples=3),
            rows(mean=(0, 0, 1)),
            rows(sd=0.0, d2=0),
            rows(),
        ]
    )
    accel[:, K], accel[:, K_END] = np.arange(7), np.arange(7) + 1
    gyro = quiet_gyro(7, sd=np.array([1e-3] * 6 + [0.02]))
    gyro[5, D2] = 0.0
    windows = Windows.of(accel, gyro, np.ones(7, int), SETTINGS)
    floors = (Floor(level=np.full(9, 0.01)), Floor(level=np.full(9, 1e-3)))
    codes = classify(windows, floors, True, SETTINGS)
    of_accel, of_gyro = trainable(windows, codes)
    assert of_accel.tolist() == [True, True, False, False, False, False, True]
    assert of_gyro.tolist() == [True, True, False, False, False, False, True]


@pytest.mark.parametrize(
    ("few", "many", "coarse"),
    [(2.0, 0.0, False), (2.001, 0.0, True), (5.0, 5.0, False), (5.0, 4.999, True), (5.0, 2.0, True)],
)
def test_a_sensor_is_coarse_where_most_of_its_quiet_windows_are(few, many, coarse):
    found = Coarseness(few=few, many=many, lsb=np.array([0.3, np.inf, 0.4]))
    assert found.coarse is coarse
    # A quantiser's error is even over its step: LSB / sqrt(12); of the steps known, as a vector.
    assert found.step == pytest.approx(0.5 / np.sqrt(12) if coarse else 0.0)


def test_a_new_sensor_is_not_known_to_be_coarse():
    assert (Coarseness().few, Coarseness().many, Coarseness().coarse, Coarseness().step) == (0, 0, False, 0)


def observed(table, looked=None, before=None, ceiling=0.15):
    half = SensorWindows.of(table, SETTINGS)
    every = np.ones(len(table), bool) if looked is None else np.array(looked)
    return (before or Coarseness()).observed(half, every, ceiling)


COARSE = {"lsb": 0.1, "low": 0.0, "high": 0.2}


def test_quiet_windows_that_were_looked_at_are_counted_by_their_codes():
    table = np.concatenate([rows(3, **COARSE), rows(2)])
    found = observed(table)
    assert (found.fresh_few, found.fresh_many, found.few, found.many) == (3, 2, 0.0, 0.0)
    assert found.fresh_lsb.tolist() == [0.1, 0.1, 0.1]
    again = observed(table, [True, False, False, False, True], before=found)
    assert (again.fresh_few, again.fresh_many) == (4, 3)


@pytest.mark.parametrize(
    ("table", "counts"),
    [
        (rows(sd=0.15 - 1e-9, **COARSE), True),
        (rows(sd=0.1501, **COARSE), False),
        (rows(d2=0, **COARSE), False),
        (rows(samples=0, **COARSE), False),
    ],
)
def test_moving_frozen_and_absent_windows_are_not_counted(table, counts):
    found = observed(np.concatenate([table, rows(sd=1.0)]))
    assert (found.fresh_few, found.fresh_many) == (int(counts), 0)


def test_few_codes_means_on_all_three_axes():
    assert observed(rows(lsb=(0.1, 0.1, 0.01), low=0.0, high=0.2)).fresh_many == 1
    assert observed(rows(lsb=(0.01, 0.1, 0.1), low=0.0, high=0.2)).fresh_many == 1
    assert observed(rows(lsb=(0.1, 0.01, 0.1), low=0.0, high=0.2)).fresh_many == 1
    assert observed(rows(lsb=(0.1, 0.2, 0.3), low=0.0, high=0.2)).fresh_few == 1


def test_the_smallest_step_of_coarse_windows_is_kept_by_axis():
    first = observed(rows(lsb=(0.2, 0.3, 0.4), low=0.0, high=0.2))
    second = observed(rows(lsb=(0.3, 0.1, 0.5), low=0.0, high=0.2), before=first)
    assert second.fresh_lsb.tolist() == [0.2, 0.1, 0.4]
    assert observed(rows(lsb=(0.01, 0.1, 0.1), low=0.0, high=0.2), before=second).fresh_lsb.tolist() == [
        0.2,
        0.1,
        0.4,
    ]


def test_counts_are_let_in_and_halve_with_a_half_life_of_windows():
    """At half a second a window and a half-life of 60 s, 240 windows leave a quarter of what was."""
    settings = DetectorSettings(half_life_s=60.0)
    before = Coarseness(few=8.0, many=4.0, lsb=np.full(3, 0.5), fresh_few=210, fresh_many=30)
    kept = before.renewed(settings)
    assert (kept.few, kept.many) == (pytest.approx(2.0 + 210), pytest.approx(1.0 + 30))
    assert (kept.fresh_few, kept.fresh_many) == (0, 0)
    assert np.isinf(kept.fresh_lsb).all()


def test_the_step_is_renewed_by_coarse_windows_only():
    lsb, fresh = np.full(3, 0.5), np.full(3, 0.25)
    assert Coarseness(lsb=lsb, fresh_few=1, fresh_lsb=fresh).renewed(SETTINGS).lsb.tolist() == [0.25] * 3
    assert Coarseness(lsb=lsb, fresh_many=1, fresh_lsb=fresh).renewed(SETTINGS).lsb.tolist() == [0.5] * 3
