"""A calibration written for a tool and read back is the same, as far as the tool can hold it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stillcal.calib_core.calibration.corrections.term import Term, TermParameter
from stillcal.calib_core.calibration.terms import polynomial
from stillcal.calib_core.errors import UserError
from stillcal.calib_core.streams.samples import Sensor
from stillcal.replay.commands.store_files import export_command
from stillcal.replay.export.imu import ImuParameters, SensorPart, facts, of_record
from stillcal.replay.export.stored import not_in_file, record_of
from stillcal.replay.export.target import Target, exported
from stillcal.replay.export.targets import INVERTIBLE, TARGETS, target_named

WITHIN = 1e-9


def test_the_help_names_the_tools_that_are_refused_without_a_phone_file() -> None:
    (option,) = [p for p in export_command.params if p.name == "phone"]
    named = str(getattr(option, "help", "")).partition("wrote. ")[2].split()
    needing = {name for name in TARGETS if target_named(name).needs_noise}
    assert needing == set(named) & TARGETS.keys() != set()


def random_imu(seed: int, *, bent: bool = False) -> ImuParameters:
    """Both sensors, with scales some per cent off, biases, slopes and g-sensitivity.

    bent: whether biases follow temperature by cubics, as a daemon learns them, which stay as they are beyond
    3 and 52 degC.
    """
    rng = np.random.default_rng(seed)

    def part(bias: float, slope: float) -> SensorPart:
        return SensorPart(
            scale=np.eye(3) + rng.uniform(-0.05, 0.05, (3, 3)),
            bias=rng.normal(0.0, bias, 3),
            slope=rng.normal(0.0, slope, 3),
            quadratic=rng.normal(0.0, slope / 20.0, 3) if bent else None,
            cubic=rng.normal(0.0, slope / 400.0, 3) if bent else None,
            reference_c=float(rng.uniform(10.0, 50.0)),
            limits=(3.0, 52.0) if bent else None,
        )

    gyro = replace(part(0.02, 1e-4), matrix=rng.normal(0.0, 1e-4, (3, 3)))
    return ImuParameters(accelerometer=part(0.3, 5e-3), gyroscope=gyro)


def within(imu: ImuParameters, target: Target) -> ImuParameters:
    """What of a calibration a target says that it holds."""
    held = target.holds(imu)

    def part(name: str, one: SensorPart) -> SensorPart:
        scale = one.scale if f"{name} scale" in held else None
        if scale is not None and f"{name} misalignment" not in held:
            scale = np.diag(np.diag(scale))
        slope = f"{name} bias slope" in held
        return SensorPart(
            scale=scale,
            bias=one.bias if f"{name} bias" in held else None,
            slope=one.slope if slope else None,
            quadratic=one.quadratic if f"{name} bias curve" in held else None,
            cubic=one.cubic if f"{name} bias curve" in held else None,
            reference_c=one.reference_c if slope else None,
            limits=one.limits if slope else None,
            matrix=one.matrix if f"{name} g-sensitivity" in held else None,
        )

    return replace(imu, **{name: part(name, one) for name, one in imu.parts()})


def bias_at(part: SensorPart, temperature: float) -> np.ndarray | None:
    return None if part.bias is None else part.bias_at(temperature)


def assert_alike(one: np.ndarray | None, other: np.ndarray | None) -> None:
    assert (one is None) == (other is None)
    if one is not None and other is not None:
        np.testing.assert_allclose(one, other, rtol=0.0, atol=WITHIN)


@pytest.mark.parametrize("name", INVERTIBLE)
@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), bent=st.booleans())
def test_what_is_written_is_read_back(name: str, seed: int, bent: bool) -> None:
    target = target_named(name)
    imu = random_imu(seed, bent=bent and "accelerometer bias curve" in target.holds(random_imu(seed)))
    wanted, back = within(imu, target), target.read(exported(target, imu, "store.json").data)
    for sensor, part in wanted.parts():
        read = getattr(back, sensor)
        if part.scale is None and part.bias is None:
            assert read is None
            continue
        assert_alike(part.scale, read.scale)
        assert_alike(part.matrix, read.matrix)
        for temperature in (-10.0, 25.0, 60.0):  # a slope may count from another temperature in the file
            assert_alike(bias_at(part, temperature), bias_at(read, temperature))


@pytest.mark.parametrize("name", TARGETS)
def test_all_that_is_known_is_in_the_file_or_named_in_it(name: str) -> None:
    target, imu = target_named(name), random_imu(1)
    if target.needs_noise:
        with pytest.raises(UserError, match="--phone"):
            exported(target, imu, "store.json")
        return
    made = exported(target, imu, "store.json")
    assert set(made.left_out) == facts(imu).keys() - target.holds(imu)
    text = made.data.decode("utf-32-le", "ignore") if name == "npz" else made.data.decode()
    for left_out in made.left_out:
        assert left_out in text


def test_the_list_of_invertible_targets_is_the_classes_own() -> None:
    assert tuple(name for name in TARGETS if target_named(name).invertible) == INVERTIBLE


@pytest.mark.parametrize("name", INVERTIBLE)
@pytest.mark.parametrize("data", [b"", b"\xff\xfe\x00", b"1\t1\tCAL", b"imu0: [", b"{}", b"imu0: 3"])
def test_what_is_no_such_file_is_refused(name: str, data: bytes) -> None:
    with pytest.raises(UserError):
        target_named(name).read(data)


def test_a_learnt_curve_goes_through_a_store_and_a_file_unchanged() -> None:
    imu = random_imu(4, bent=True)
    record = record_of(target_named("px4").read(exported(target_named("px4"), imu, "a").data), None, "a")
    again = of_record(record)
    for (_, part), (_, back) in zip(imu.parts(), again.parts(), strict=True):
        for temperature in (-30.0, 3.5, 25.0, 51.0, 52.5, 80.0):
            assert_alike(bias_at(part, temperature), bias_at(back, temperature))
    accel = record.terms[0]
    assert {"slope", "quadratic", "cubic"} == accel.parameters.keys()
    warm = np.array([-5.0, 25.0, 60.0])
    wanted = (
        [imu.accelerometer.bias_at(t) - imu.accelerometer.offset for t in warm] if imu.accelerometer else []
    )
    np.testing.assert_allclose(polynomial(accel, warm), wanted, atol=WITHIN)


@pytest.mark.parametrize("name", INVERTIBLE)
def test_a_file_read_back_into_its_own_store_changes_neither_scale_nor_bias(name: str) -> None:
    before, target = record_of(random_imu(6), None, "a"), target_named(name)
    back = target.read(exported(target, of_record(before), "a").data)
    for (_, part), (_, again) in zip(
        of_record(before).parts(), of_record(record_of(back, before, "b")).parts(), strict=True
    ):
        assert_alike(part.scale, again.scale)
        known_at = again.reference_c or part.reference_c or 0.0
        assert_alike(part.bias_at(known_at), again.bias_at(known_at))
    crossed = [line for line in not_in_file(back, before) if "misalignment" in line]
    assert bool(crossed) == (name in ("px4", "ardupilot", "iio"))


def test_what_a_store_holds_beyond_all_targets_is_named_too(make_record) -> None:
    record = make_record(1)
    strange = Term(
        effect="gyro_curl",
        sensor=Sensor.GYROSCOPE,
        parameters={"curl": TermParameter(value=np.array([1.0, 2.0, 3.0]), unit="1")},
    )
    known = facts(of_record(replace(record, terms=(strange,))))
    assert known["gyro_curl"] == "curl [1.0, 2.0, 3.0] 1"


def test_a_new_bias_without_a_slope_ends_the_curve_of_the_old_one() -> None:
    """At which temperature it holds is not known, so the old curve has nowhere to count from."""
    before = record_of(random_imu(5), None, "a")
    assert len(before.terms) == 3
    fresh = ImuParameters(accelerometer=SensorPart(bias=np.array([0.1, 0.2, 0.3])))
    after = record_of(fresh, before, "b")
    assert {term.effect for term in after.terms} == {"gyro_bias_temperature", "gyro_g_sensitivity"}
    assert after.accelerometer is not None and before.accelerometer is not None
    np.testing.assert_array_equal(after.accelerometer.scale, before.accelerometer.scale)


@pytest.mark.parametrize("name", sorted(INVERTIBLE))
@pytest.mark.parametrize("moved", [0.0, 1e-3])
def test_what_becomes_of_a_curve_that_the_file_does_not_hold_is_said(name: str, moved: float) -> None:
    imu = random_imu(5, bent=True)
    before = record_of(imu, None, "test")
    target = target_named(name)
    back = target.read(exported(target, imu, "store.json").data)
    for sensor, part in back.parts():
        old = getattr(imu, sensor)
        if part.bias is None or old.slope is None:
            continue
        back = replace(back, **{sensor: replace(part, bias=part.bias + moved)})
        after = getattr(of_record(record_of(back, before, "test")), sensor)
        told = " ".join(line for line in not_in_file(back, before) if line.startswith(f"{sensor} bias"))
        if part.slope is None and not moved:
            assert "the store keeps its own" in told
            assert_alike(bias_at(after, 40.0), bias_at(old, 40.0))
        elif part.slope is None:
            assert "dropped" in told and after.slope is None
        else:
            assert ("straight line" in told) == (not part.bent)
