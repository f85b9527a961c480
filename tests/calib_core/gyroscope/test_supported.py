"""What a gyroscope's turns can show: the largest model they support, what is missing, and refusals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from msgspec import structs
from scipy.spatial.transform import Rotation

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.errors import NotSupported
from stillcal.calib_core.gyroscope import fit as gyroscope
from stillcal.calib_core.gyroscope.fit import GyroscopeSettings, Parameters
from tests.support.turned_phones import ACCEL, G, X, Y, Z, later, recorded, recording, some_phone


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
    upright = later(recorded(rng, phone, 8, about=(Z,), start=Rotation.identity(), wobble=0.0), 1000.0)
    with pytest.raises(NotSupported) as refusal:
        gyroscope.fit([*level.turns, *upright.turns], ACCEL, G, parameters=Parameters.FULL9)
    assert refusal.value.missing == ("a few turns about z with z level, from rest to rest",)


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
    with pytest.raises(NotSupported, match="no rotation between"):
        gyroscope.fit([], ACCEL, G, rests=trip.rests, parameters=Parameters.SCALE3)
    with pytest.raises(NotSupported, match="gyroscope"):
        gyroscope.fit([], ACCEL, G, rests=[structs.replace(trip.rests[0], rate=None)])


@pytest.mark.parametrize(
    "change", [{"nominal_error": 0.0}, {"outlier": 1.0}, {"max_iterations": 0}, {"bias_shift": -1.0}]
)
def test_settings_out_of_range_are_refused(change: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(change))):
        GyroscopeSettings(**change)  # type: ignore[arg-type]
