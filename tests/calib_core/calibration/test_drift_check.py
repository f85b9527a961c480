"""The hourly check of the calibration in use."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace

from stillcal.calib_core.calibration.drift_check import (
    VERDICTS,
    Drift,
    QualitySettings,
    Verdict,
    check_calibration,
    check_rests,
    norm_residuals,
    norm_uncertainty,
)
from stillcal.calib_core.calibration.record import AccelerometerRecord, CalibrationRecord
from stillcal.calib_core.calibration.rest_pool import HeldRest, Pool
from stillcal.calib_core.gravity import Gravity
from stillcal.calib_core.model import SensorModel
from stillcal.calib_core.static.rest import RestState

SETTINGS = QualitySettings()
IDENTITY = SensorModel.identity()


def held(force: list[float], rate: list[float] | None = None, uncertainty: float = 1e-3) -> HeldRest:
    sigma = np.full(3, uncertainty)
    rest = RestState(
        0,
        10,
        1000,
        np.array(force),
        sigma,
        sigma,
        uncertainty,
        rate=None if rate is None else np.array(rate),
        rate_uncertainty=None if rate is None else np.full(3, 1e-5),
    )
    return HeldRest(rest, Gravity(9.8, 0.0, "given"))


def test_every_pair_of_findings_has_a_verdict() -> None:
    assert set(VERDICTS) == {(a, g) for a in Drift for g in Drift}
    assert VERDICTS[Drift.DRIFTED, Drift.NONE] is Verdict.RECALIBRATE


def test_nothing_seen_is_nothing_said() -> None:
    assert check_rests(IDENTITY, 0.001, np.zeros(3), [], SETTINGS).verdict is Verdict.WAIT


@pytest.mark.parametrize(
    ("force", "rate", "verdict"),
    [
        ([0, 0, 9.801], [0, 0, 0], Verdict.KEEP),
        ([0, 0, 9.801], [0, 0.01, 0], Verdict.UPDATE_BIAS),
        ([0, 0, 9.9], [0, 0, 0], Verdict.RECALIBRATE),
        ([0, 9.7, 0], None, Verdict.RECALIBRATE),
        ([0, 9.8, 0], None, Verdict.KEEP),
    ],
)
def test_drift_of_either_sensor_is_told_apart(
    force: list[float], rate: list[float] | None, verdict: Verdict
) -> None:
    found = check_rests(IDENTITY, 0.002, np.zeros(3), [held(force, rate)] * 2, SETTINGS)
    assert found.verdict is verdict
    assert found.accel_residual == pytest.approx(np.linalg.norm(force) - 9.8)


def test_a_drift_within_its_uncertainty_is_none() -> None:
    far = [0, 0, 9.85]

    def found(norm_uncertainty: float, own: float = 1e-3) -> Drift:
        return check_rests(
            IDENTITY, norm_uncertainty, None, [held(far, uncertainty=own)] * 2, SETTINGS
        ).accelerometer

    assert found(0.001) is Drift.DRIFTED
    assert found(0.050) is Drift.NONE
    assert found(0.001, own=0.05) is Drift.NONE


def test_a_change_of_bias_shows_though_its_norms_cancel() -> None:
    """0.1 m/s^2 more on x: the norm grows with x up and shrinks with x down."""
    moved = [held([9.9, 0, 0]), held([-9.7, 0, 0]), held([0, 0, 9.8]), held([0, 0, -9.8])]
    found = check_rests(IDENTITY, 0.002, None, moved, SETTINGS)
    assert found.accel_residual == pytest.approx(0, abs=1e-9)
    assert (found.accelerometer, found.rests_off) == (Drift.DRIFTED, 2)


def test_one_rest_off_waits_for_another_and_is_outvoted_by_many() -> None:
    bad, good = held([0, 0, 9.9]), held([0, 9.8, 0])
    assert check_rests(IDENTITY, 0.002, None, [bad], SETTINGS).verdict is Verdict.WAIT
    assert check_rests(IDENTITY, 0.002, None, [bad, good], SETTINGS).verdict is Verdict.WAIT
    terrible = held([0, 0, 12.0])
    assert check_rests(IDENTITY, 0.002, None, [terrible, *[good] * 9], SETTINGS).verdict is Verdict.KEEP


# Both sides of each line


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("significance", 0.0),
        ("accel_limit", 0.0),
        ("gyro_limit", 0.0),
        ("accel_limit", np.nan),
        ("chance", 0.0),
        ("chance", 0.5),
        ("held_out_rests", 5),
    ],
)
def test_settings_beyond_their_limits_are_refused_by_name(field: str, value: float) -> None:
    with pytest.raises(ValueError, match=f"{field} = "):
        QualitySettings(**{field: value})  # type: ignore[arg-type]


def test_settings_at_their_limits_are_taken() -> None:
    """Six rests that all speak for one side are a chance of 1 in 64: 0.0156, under 0.025; so is equality."""
    assert QualitySettings().held_out_rests == 6
    for fields in (
        {"significance": 1e-9, "accel_limit": 1e-9, "gyro_limit": 1e-9},
        {"chance": 0.4999},
        {"chance": 2.0**-6},
        {"chance": 1e-3, "held_out_rests": 10},
    ):
        assert QualitySettings(**fields)  # type: ignore[arg-type]


def test_what_follows_from_each_pair_is_the_papers_table() -> None:
    """Section 4.7: the accelerometer decides; where it tells nothing, one waits."""
    unknown, none, drifted = Drift.UNKNOWN, Drift.NONE, Drift.DRIFTED
    assert {VERDICTS[unknown, gyro] for gyro in Drift} == {Verdict.WAIT}
    assert {VERDICTS[drifted, gyro] for gyro in Drift} == {Verdict.RECALIBRATE}
    assert [VERDICTS[none, gyro] for gyro in (unknown, none, drifted)] == [
        Verdict.KEEP,
        Verdict.KEEP,
        Verdict.UPDATE_BIAS,
    ]


def off_by(*amounts: float, uncertainty: float = 1e-4) -> list[HeldRest]:
    """Rests whose norms are off by these amounts, in m/s^2, one after the other by 100 s."""
    rests = [held([0, 0, 9.8 + amount], uncertainty=uncertainty) for amount in amounts]
    moved = [replace(h.rest, t_start=100.0 * (k + 1)) for k, h in enumerate(rests)]
    return [HeldRest(rest, h.gravity) for rest, h in zip(moved, rests, strict=True)]


@pytest.mark.parametrize(
    ("amount", "norm_uncertainty", "drift"),
    [
        (0.0199, 0.001, Drift.NONE),
        (0.0201, 0.001, Drift.DRIFTED),
        (-0.0201, 0.001, Drift.DRIFTED),
        (0.0299, 0.01, Drift.NONE),
        (0.0301, 0.01, Drift.DRIFTED),
    ],
)
def test_two_rests_are_off_beyond_the_limit_and_three_uncertainties(
    amount: float, norm_uncertainty: float, drift: Drift
) -> None:
    found = check_rests(IDENTITY, norm_uncertainty, None, off_by(amount, amount), SETTINGS)
    assert found.accelerometer is drift
    assert found.rests_off == (2 if drift is Drift.DRIFTED else 0)


def test_uncertainties_of_a_rest_and_of_the_calibration_add_in_squares() -> None:
    """3 sqrt(0.006^2 + 0.008^2) = 0.03."""
    for amount, off in ((0.0299, 0), (0.0301, 1)):
        found = check_rests(IDENTITY, 0.006, None, off_by(amount, uncertainty=0.008), SETTINGS)
        assert found.rests_off == off


@pytest.mark.parametrize(
    ("good", "verdict"),
    [(0, Verdict.WAIT), (1, Verdict.WAIT), (2, Verdict.WAIT), (3, Verdict.KEEP), (9, Verdict.KEEP)],
)
def test_one_rest_off_among_three_waits_and_among_four_is_outvoted(good: int, verdict: Verdict) -> None:
    found = check_rests(IDENTITY, 0.002, None, off_by(0.5, *[0.0] * good), SETTINGS)
    assert (found.verdict, found.rests_off) == (verdict, 1)


def test_two_rests_off_by_opposite_amounts_are_enough_among_many() -> None:
    """The bias moved on one axis, which was held up twice: the other twenty rests do not outvote them."""
    found = check_rests(IDENTITY, 0.002, None, off_by(0.1, -0.1, *[0.0] * 20), SETTINGS)
    assert (found.accelerometer, found.rests_off) == (Drift.DRIFTED, 2)


def test_the_mean_is_off_where_no_single_rest_is() -> None:
    """Ten rests, each off by 0.025 with an uncertainty of 0.01: none by itself, their mean is."""
    found = check_rests(IDENTITY, 0.001, None, off_by(*[0.025] * 10, uncertainty=0.01), SETTINGS)
    assert (found.accelerometer, found.rests_off) == (Drift.DRIFTED, 0)
    assert check_rests(IDENTITY, 0.01, None, off_by(*[0.025] * 10, uncertainty=0.01), SETTINGS).verdict is (
        Verdict.KEEP
    )


def test_the_mean_is_taken_without_the_rest_that_disagrees_most() -> None:
    """One rest off by much among nine others off by a little less than the limit: no drift."""
    found = check_rests(IDENTITY, 0.001, None, off_by(*[0.018] * 5, 9.0, *[0.018] * 4), SETTINGS)
    assert (found.accelerometer, found.rests_off) == (Drift.NONE, 1)
    assert found.off_since == 600.0


def test_a_single_rest_that_is_not_off_says_all_is_well() -> None:
    found = check_rests(IDENTITY, 0.001, None, off_by(0.019), SETTINGS)
    assert (found.verdict, found.rests, found.rests_off, found.off_since) == (Verdict.KEEP, 1, 0, None)


def test_it_is_said_since_when_rests_are_off() -> None:
    found = check_rests(IDENTITY, 0.001, None, off_by(0.0, 0.0, 0.3, 0.0, 0.4), SETTINGS)
    assert (found.rests_off, found.off_since, found.rests) == (2, 300.0, 5)


def test_the_mean_weighs_rests_by_their_uncertainty() -> None:
    """Off by 0.010 +- 0.001 and 0.001 +- 0.002: weights 4 to 1, and the calibration's 0.003 on top."""
    rests = [*off_by(0.010, uncertainty=0.001), *off_by(0.001, uncertainty=0.002)]
    found = check_rests(IDENTITY, 0.003, None, rests, SETTINGS)
    assert found.accel_residual == pytest.approx((4 * 0.010 + 0.001) / 5)
    assert found.accel_uncertainty == pytest.approx(np.hypot(0.001 * np.sqrt(4 / 5), 0.003))


def test_a_rest_without_uncertainty_is_no_division_by_zero() -> None:
    found = check_rests(IDENTITY, 0.003, None, off_by(0.01, 0.01, uncertainty=0.0), SETTINGS)
    assert found.accel_residual == pytest.approx(0.01)
    assert found.accel_uncertainty == pytest.approx(0.003)


def turning(*rates: list[float], uncertainty: list[float] | None = None) -> list[HeldRest]:
    rests = [held([0, 0, 9.8], rate) for rate in rates]
    sure = np.array(uncertainty or [1e-5] * 3)
    return [HeldRest(replace(h.rest, rate_uncertainty=sure), h.gravity) for h in rests]


@pytest.mark.parametrize(
    ("rate", "uncertainty", "drift"),
    [
        (0.00099, 1e-5, Drift.NONE),
        (0.00101, 1e-5, Drift.DRIFTED),
        (-0.00101, 1e-5, Drift.DRIFTED),
        (0.00299, 1e-3, Drift.NONE),
        (0.00301, 1e-3, Drift.DRIFTED),
    ],
)
@pytest.mark.parametrize("axis", range(3))
def test_the_gyroscope_has_drifted_beyond_its_limit_and_three_uncertainties(
    axis: int, rate: float, uncertainty: float, drift: Drift
) -> None:
    bias = np.array([0.1, -0.2, 0.3])
    seen = bias + rate * np.eye(3)[axis]
    found = check_rests(
        IDENTITY, 0.002, bias, turning(seen.tolist(), uncertainty=[uncertainty] * 3), SETTINGS
    )
    assert found.gyroscope is drift
    assert found.gyro_residual == pytest.approx(rate)
    assert found.gyro_uncertainty == pytest.approx(uncertainty)


def test_rates_are_weighed_by_axis_and_the_largest_difference_is_told() -> None:
    first = turning([0.0, 0.004, 0.0], uncertainty=[1e-5, 1e-3, 1e-5])
    second = turning([0.0, 0.001, -0.001], uncertainty=[1e-5, 5e-4, 1e-5])
    found = check_rests(IDENTITY, 0.002, np.zeros(3), first + second, SETTINGS)
    assert found.gyro_residual == pytest.approx((0.004 + 4 * 0.001) / 5)
    assert found.gyro_uncertainty == pytest.approx(1 / np.sqrt(1e6 + 4e6))


def test_without_a_rate_or_a_bias_the_gyroscope_is_unknown() -> None:
    assert check_rests(IDENTITY, 0.002, None, turning([0, 0, 0]), SETTINGS).gyroscope is Drift.UNKNOWN
    found = check_rests(IDENTITY, 0.002, np.zeros(3), [held([0, 0, 9.8])], SETTINGS)
    assert (found.gyroscope, found.gyro_residual, found.gyro_uncertainty) == (Drift.UNKNOWN, None, None)
    unsure = held([0, 0, 9.8], [0, 0.005, 0])
    without = HeldRest(replace(unsure.rest, rate_uncertainty=None), unsure.gravity)
    assert check_rests(IDENTITY, 0.002, np.zeros(3), [without], SETTINGS).gyroscope is Drift.UNKNOWN
    mixed = [held([0, 0, 9.8]), *turning([0, 0.005, 0])]
    assert check_rests(IDENTITY, 0.002, np.zeros(3), mixed, SETTINGS).gyroscope is Drift.DRIFTED


def test_a_norms_uncertainty_is_carried_along_gravity_through_the_scale() -> None:
    """scale diag(2, 1, 0.5): raw (0, 3, 8) is (0, 3, 4) and 5 long; along it sd (., 0.1, 0.2) makes
    hypot(3/5 * 1 * 0.1, 4/5 * 0.5 * 0.2) = 0.1."""
    rest = replace(held([0.5, 3.0, 8.0]).rest, force_uncertainty=np.array([7.0, 0.1, 0.2]))
    model = SensorModel.of(np.diag([2.0, 1.0, 0.5]), np.array([0.5, 0.0, 0.0]))
    residual, own = norm_residuals(model, [HeldRest(rest, Gravity(4.9, 0.0, "given"))])
    assert residual.tolist() == [pytest.approx(0.1)]
    assert own.tolist() == [pytest.approx(0.1)]


def test_a_calibration_without_cross_axis_terms_leaves_their_size_open() -> None:
    def part(parameters: int, rms: float | None) -> AccelerometerRecord:
        return AccelerometerRecord(
            scale=np.eye(3), bias=np.zeros(3), parameters=parameters, rms_residual=rms, gravity=9.8
        )

    up = 9.8 * np.eye(3)
    assert norm_uncertainty(part(9, 0.012), up) == pytest.approx(0.012)
    assert norm_uncertainty(part(6, 0.012), up) == pytest.approx(0.0514, abs=1e-4)  # hypot(0.012, 0.05)
    assert norm_uncertainty(part(9, None), up).tolist() == [0.0] * 3


@pytest.mark.parametrize(("source", "verdict"), [("given", Verdict.KEEP), ("location", Verdict.RECALIBRATE)])
def test_gravity_known_from_elsewhere_than_when_calibrated_is_no_drift(source: str, verdict: Verdict) -> None:
    """Calibrated under the standard gravity, uncertain by 0.013: 0.03 off is within three of that."""
    accelerometer = AccelerometerRecord(scale=np.eye(3), bias=np.zeros(3), parameters=9, gravity=9.8)
    record = CalibrationRecord(
        accelerometer=accelerometer,
        gyroscope=None,
        gravity=Gravity(9.8, 0.0133, source),  # type: ignore[arg-type]
    )
    rests = off_by(0.03, 0.03)
    at_home = Pool(tuple(HeldRest(h.rest, Gravity(9.8, 0.0, "location")) for h in rests))
    assert check_calibration(record, at_home, SETTINGS).verdict is verdict


def test_a_check_says_only_what_it_measured() -> None:
    figures = check_rests(IDENTITY, 0.001, None, off_by(0.01), SETTINGS).figures()
    assert "gyro_residual" not in figures and "off_since" not in figures
    assert figures["accel_residual"] == pytest.approx(0.01)
    assert (figures["rests"], figures["rests_off"]) == (1, 0)
