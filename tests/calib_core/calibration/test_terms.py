"""Terms beyond the affine model: what a diagnosis found, taken into a calibration and applied."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
from click.testing import CliRunner

from stillcal.calib_core.arrays import frozen
from stillcal.calib_core.calibration.candidate import CalibrateSettings, fit_candidate, with_updated_bias
from stillcal.calib_core.calibration.corrections.term import Term, TermParameter
from stillcal.calib_core.calibration.drift_check import QualitySettings, Verdict, check_calibration
from stillcal.calib_core.calibration.record import CalibrationRecord, GyroscopeRecord
from stillcal.calib_core.calibration.rest_pool import HeldRest, Pool
from stillcal.calib_core.calibration.terms import compensated, correct, correct_both
from stillcal.calib_core.codec import packed, unpacked
from stillcal.calib_core.errors import NotSupported
from stillcal.calib_core.gravity import Gravity
from stillcal.calib_core.maths.rms import rms
from stillcal.calib_core.static.rest import RestState
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.calib_core.temperature.charger import Charger
from stillcal.calib_core.temperature.forecast import Forecast
from stillcal.calib_core.temperature.thermometer import Thermometer
from stillcal.daemon.cli.store import store_group
from stillcal.daemon.service.live_stream import LiveBlock, LiveStream
from stillcal.daemon.store.store import Store
from stillcal.replay.phone import draw_rests, load_phone
from tests.support.adopted import with_terms

SLOPE = np.array([0.012, -0.008, 0.01])
SENSITIVITY = 1e-4 * np.array([[1.0, 0.2, 0.0], [0.0, -2.0, 0.3], [0.5, 0.0, 1.5]])
MATRIX = {
    "effect": "gyro_g_sensitivity",
    "parameters": {"matrix": {"value": SENSITIVITY.tolist(), "unit": "s/m"}},
}


def finding(slope: np.ndarray, **more: object) -> dict[str, object]:
    told = {"value": slope.tolist(), "ci95": [[v - 1e-3, v + 1e-3] for v in slope], "unit": "m/s^2/K"}
    return {"effect": "accel_bias_temperature", "parameters": {"slope": told}, "alternatives": [], **more}


def warm_rests(number: int, low: float, high: float) -> tuple[Pool, np.ndarray]:
    """Return 40 rests of a phone whose bias follows the temperature, between two temperatures (degC)."""
    rng = np.random.default_rng(number)
    warmth = rng.uniform(low, high, 40)
    quiet = load_phone("typical")
    noise = msgspec.structs.replace(quiet.accel.noise, flicker=0.0)
    phone = msgspec.structs.replace(quiet, accel=msgspec.structs.replace(quiet.accel, noise=noise))
    drawn = draw_rests(phone, 40, number)
    forces = drawn.forces + (warmth - 25.0)[:, None] * SLOPE
    rows = zip(drawn.t, drawn.duration, forces, drawn.white_uncertainties, warmth, strict=True)
    rests = [
        RestState(t, t + d, int(100 * d), frozen(f), frozen(30 * u), frozen(u), 0.01, temperature=float(w))
        for t, d, f, u, w in rows
    ]
    gravity = Gravity(drawn.gravity, 0.0, "given")
    return Pool(tuple(HeldRest(rest, gravity) for rest in rests)), warmth


@pytest.fixture(scope="module")
def record() -> CalibrationRecord:
    pool, _ = warm_rests(1, 20.0, 24.0)
    return fit_candidate(pool, pool.held[0].gravity, 1e5, CalibrateSettings()).record


def norm_error(record: CalibrationRecord, temperature: bool) -> float:
    """Return the rms error (m/s^2) of the norm over rests that were never seen, at 30 to 45 degC."""
    pool, warmth = warm_rests(2, 30.0, 45.0)
    raw = Samples(
        Sensor.ACCELEROMETER,
        frozen(np.arange(40.0)),
        frozen([h.rest.specific_force for h in pool.held]),
        temperature=frozen(warmth) if temperature else None,
    )
    norms = np.linalg.norm(correct(record, raw).xyz, axis=1)
    return rms(norms - pool.held[0].gravity.value)


def test_a_curve_counts_from_the_calibrations_own_temperature(record: CalibrationRecord) -> None:
    """The diagnosis counted from 30 degC, the rests of the calibration lie about 22."""
    told = finding(SLOPE, reference={"temperature_c": 30.0})
    told["parameters"] |= {"quadratic": {"value": [2e-4, 0.0, -1e-4], "ci95": [[0.0, 4e-4]] * 3, "unit": ""}}
    (term,) = with_terms(record, [told]).terms
    quadratic = np.array([2e-4, 0.0, -1e-4])

    own = term.reference["temperature"]
    assert own == pytest.approx(22.0, abs=1.0)

    def at(celsius: float) -> np.ndarray:
        return np.asarray(SLOPE * (celsius - 30.0) + quadratic * (celsius - 30.0) ** 2)

    warmer = 3.0 * term.parameters["slope"].value + 9.0 * term.parameters["quadratic"].value
    np.testing.assert_allclose(warmer, at(own + 3.0) - at(own))
    reach = np.hypot(1e-3, 2.0 * (own - 30.0) * 2e-4)
    np.testing.assert_allclose(np.ptp(term.parameters["slope"].ci95, axis=1), 2.0 * reach)


def test_a_warm_phone_is_corrected_on_rests_never_seen(record: CalibrationRecord) -> None:
    """15 K above the rests it was calibrated on the slope is 0.26 m/s^2; of that, one tenth is a bar."""
    before, after = norm_error(record, True), norm_error(with_terms(record, [finding(SLOPE)]), True)
    assert before > 0.05
    assert after < before / 10


def test_without_a_temperature_next_to_nothing_changes(record: CalibrationRecord) -> None:
    """The bias is fitted anew, to rests of 20 to 24 degC."""
    after = norm_error(with_terms(record, [finding(SLOPE)]), False)
    assert after == pytest.approx(norm_error(record, False), rel=0.05)


def test_it_counts_from_where_the_calibration_stands(record: CalibrationRecord) -> None:
    term = with_terms(record, [finding(SLOPE)]).terms[0]
    assert 20.0 < term.reference["temperature"] < 24.0
    known = with_terms(record, [finding(SLOPE)])
    pool, _ = warm_rests(3, 34.0, 38.0)
    new = fit_candidate(pool, pool.held[0].gravity, 2e5, CalibrateSettings(), known).record
    assert new.terms == known.terms
    assert new.accelerometer is not None and record.accelerometer is not None
    assert new.accelerometer.bias == pytest.approx(record.accelerometer.bias, abs=5e-3)
    assert norm_error(new, True) < norm_error(record, True) / 10


def test_what_a_curve_showed_outlives_a_new_calibration(record: CalibrationRecord) -> None:
    """The forecast of a bias whose curve is in use is of that bias alone, and does not."""
    followed = Forecast(
        at=1e5, reference=22.0, curve=np.zeros((3, 3)), error=np.zeros((4, 3)),
        covariance=np.zeros((12, 12)), white=0.0, flicker=0.0, walk=0.0,
    )  # fmt: skip
    pool, _ = warm_rests(3, 20.0, 24.0)
    for since, forecast in ((None, followed), (1e5, replace(followed, unfollowed_since=1e5))):
        known = replace(record, forecast={"accelerometer": forecast})
        new = fit_candidate(pool, pool.held[0].gravity, 2e5, CalibrateSettings(), known).record
        assert new.forecast == ({} if since is None else known.forecast)


def test_a_term_is_followed_only_a_little_beyond_its_temperatures(record: CalibrationRecord) -> None:
    """Held: 20 to 24 degC; beyond, by a quarter of that span and 1 K, so to 26 degC."""
    term = with_terms(record, [finding(SLOPE)]).terms[0]
    span = {"temperature": 22.0, "temperature_min": 20.0, "temperature_max": 24.0}
    known = replace(record, terms=(replace(term, reference=span),))
    pool, _ = warm_rests(3, 36.0, 37.0)
    moved = compensated(pool, known).rests[0].specific_force - pool.rests[0].specific_force
    assert moved == pytest.approx(-4.0 * SLOPE)
    free = compensated(pool, with_terms(record, [finding(SLOPE)])).rests[0].specific_force
    assert np.abs(free - pool.rests[0].specific_force).max() > 13 * np.abs(SLOPE).max()
    lying, _ = warm_rests(3, 60.0, 61.0)
    assert compensated(lying, known).rests[0].specific_force == pytest.approx(lying.rests[0].specific_force)


def test_a_gyroscope_that_feels_force_is_corrected(record: CalibrationRecord) -> None:
    gyro = GyroscopeRecord(scale=np.eye(3), bias=np.zeros(3), parameters=3)
    known = with_terms(replace(record, gyroscope=gyro), [MATRIX])
    force = np.random.default_rng(4).normal(size=(50, 3)) * 9.8
    raw = Samples(Sensor.GYROSCOPE, frozen(np.arange(50.0)), frozen(force @ SENSITIVITY.T))
    assert np.abs(correct(known, raw, force).xyz).max() < 1e-15
    assert correct(known, raw).xyz == pytest.approx(raw.xyz)


def test_terms_are_kept_with_the_record(record: CalibrationRecord) -> None:
    known = with_terms(record, [finding(SLOPE), MATRIX])
    again = unpacked(packed(known), CalibrationRecord)
    assert again.id == known.id != record.id
    assert len(with_terms(known, [finding(2 * SLOPE)]).terms) == 2


@pytest.mark.parametrize(
    "bad",
    [
        [],
        [{"effect": "clock_skew", "parameters": {}}],
        [finding(SLOPE, alternatives=[{"effect": "accel_warmup", "indistinguishable": True}])],
    ],
)
def test_what_cannot_be_applied_is_refused(record: CalibrationRecord, bad: list) -> None:
    with pytest.raises(NotSupported, match="no finding can be applied"):
        with_terms(record, bad)


def test_malformed_findings_and_rests_without_temperature_are_refused(record: CalibrationRecord) -> None:
    for slope, why in ((np.ones(2), r"shape \(2,\): expected \(3,\)"), (np.full(3, np.nan), "finite")):
        with pytest.raises(ValueError, match=why):
            with_terms(record, [finding(slope)])
    cold = replace(record, states=(), validity=type(record.validity)())
    with pytest.raises(NotSupported, match="no temperature"):
        with_terms(cold, [finding(SLOPE)])


def test_a_store_adopts_them_and_shows_them(tmp_path: Path, record: CalibrationRecord) -> None:
    store, diagnosis = tmp_path / "store.json", tmp_path / "day.json"
    Store(store).publish(record)
    diagnosis.write_text(json.dumps({"schema": 1, "findings": [finding(SLOPE)]}))
    run = CliRunner().invoke
    assert "accel_bias_temperature" in run(store_group, ["adopt-terms", str(store), str(diagnosis)]).output
    assert "slope [0.012, -0.008, 0.01] m/s^2/K" in run(store_group, ["show", str(store)]).output
    assert Store(store).rollback().document.current.id == record.id
    diagnosis.write_text("[]")
    assert run(store_group, ["adopt-terms", str(store), str(diagnosis)]).exit_code == 2


def test_the_hourly_check_takes_the_terms_off_first(record: CalibrationRecord) -> None:
    """Rests 20 K warmer than the calibration: no drift with the term, and drift without it."""
    hot, _ = warm_rests(7, 45.0, 46.0)
    known = with_terms(record, [finding(SLOPE)])
    assert check_calibration(known, hot, QualitySettings()).verdict is Verdict.KEEP
    assert check_calibration(record, hot, QualitySettings()).verdict is Verdict.RECALIBRATE


def test_the_gyroscopes_bias_is_measured_without_what_force_adds(record: CalibrationRecord) -> None:
    """In one attitude force and bias look alike; by the term they are told apart."""
    bias, force, sd = np.array([0.01, 0.0, -0.02]), np.array([0.0, 9.8, 0.0]), np.full(3, 1e-5)
    rest = RestState(
        0.0, 60.0, 6000, frozen(force), frozen(sd), frozen(sd), 0.01,
        rate=frozen(bias + SENSITIVITY @ force), rate_sd=frozen(sd), rate_uncertainty=frozen(sd),
    )  # fmt: skip
    plain = CalibrationRecord(gyroscope=GyroscopeRecord(scale=np.eye(3), bias=np.zeros(3), parameters=3))
    pool = Pool((HeldRest(rest, Gravity()),))
    for known, expected in ((plain, bias + SENSITIVITY @ force), (with_terms(plain, [MATRIX]), bias)):
        measured = with_updated_bias(known, compensated(pool, known), 60.0)
        assert measured is not None and measured.gyroscope is not None
        assert measured.gyroscope.bias == pytest.approx(expected, abs=1e-9)


def test_a_gyroscope_without_a_thermometer_takes_the_accelerometers(record: CalibrationRecord) -> None:
    """Phones tell the temperature with one sensor; the bias of both stands at the reference."""
    gyro = GyroscopeRecord(scale=np.eye(3), bias=np.array([0.01, 0.0, -0.02]), parameters=3)
    slope = TermParameter(value=np.array([1e-3, 0.0, -2e-3]), unit="rad/s/K")
    reference = {"temperature": 20.0}
    known = replace(
        record,
        gyroscope=gyro,
        terms=(
            Term(
                effect="gyro_bias_temperature",
                sensor=Sensor.GYROSCOPE,
                parameters={"slope": slope},
                reference=reference,
            ),
        ),
    )
    t, celsius = np.arange(4.0), np.array([20.0, 21.0, 25.0, 30.0])
    force = Samples.checked(Sensor.ACCELEROMETER, t, np.tile([0.0, 0.0, 9.8], (4, 1)), celsius)
    true_bias = gyro.bias + (celsius - 20.0)[:, None] * slope.value
    rate = Samples.checked(Sensor.GYROSCOPE, t + 0.1, true_bias)
    _, corrected = correct_both(known, force, rate)
    assert corrected is not None and corrected.temperature is None
    np.testing.assert_allclose(corrected.xyz, 0.0, atol=1e-12)
    live = LiveStream()
    listener, _ = live.subscribe(0.0)
    live.take([rate, force], known, 0.0, Thermometer(), Charger())
    sent = [listener.queue.get_nowait() for _ in range(2)][-1]
    assert isinstance(sent, LiveBlock)
    np.testing.assert_allclose(sent.samples.xyz, 0.0, atol=1e-12)
