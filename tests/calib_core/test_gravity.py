"""Local gravity against published values."""

from __future__ import annotations

import pytest
from hypothesis import given as hypothesis_given
from hypothesis import strategies as st

from stillcal.calib_core import gravity


def test_somigliana_at_the_published_latitudes() -> None:
    # NGA TR8350.2 Table 3.4 (equator, pole); Moritz, GRS80: 9.806199203 at 45 deg, WGS-84 near it.
    assert gravity.somigliana(0) == pytest.approx(9.7803253359, abs=1e-10)
    assert gravity.somigliana(90) == pytest.approx(9.8321849378, abs=2e-9)
    assert gravity.somigliana(-90) == gravity.somigliana(90)
    assert gravity.somigliana(45) == pytest.approx(9.806199203, abs=3e-6)


def test_igf_is_the_printed_formula() -> None:
    # Eq. 17 at the equator and the pole by hand: 9.780327, and 9.780327 * 1.0053024.
    assert gravity.igf(0) == 9.780327
    assert gravity.igf(90) == pytest.approx(9.780327 * 1.0053024, abs=1e-12)
    assert gravity.igf(0) - gravity.igf(0, 1000) == pytest.approx(3.086e-3, abs=1e-12)


def test_the_g_of_the_papers_table_8_is_found_where_its_dataset_was_recorded() -> None:
    # Grammenos et al., Table 8, use g = 9.81676; the recordings are from Aalborg, 57.05 N.
    assert gravity.igf(57.05) == pytest.approx(9.81676, abs=2e-4)
    assert gravity.somigliana(57.05) == pytest.approx(9.81676, abs=2e-4)


def test_second_order_free_air_on_a_high_mountain() -> None:
    # The usual expansion (3.0877e-6 - 4.3e-9 sin^2 phi) h - 7.2e-13 h^2 (Torge, Geodesy, 2001).
    drop = gravity.somigliana(45) - gravity.somigliana(45, 4000)
    assert drop == pytest.approx((3.0877e-6 - 4.3e-9 / 2) * 4000 - 7.2e-13 * 4000**2, rel=1e-4)


@hypothesis_given(st.floats(-90, 90), st.floats(0, 3000))
def test_the_two_formulas_agree_within_the_anomaly(latitude: float, altitude: float) -> None:
    assert gravity.igf(latitude, altitude) == pytest.approx(gravity.somigliana(latitude, altitude), abs=3e-5)


@hypothesis_given(st.floats(-90, 90))
def test_the_default_covers_every_latitude(latitude: float) -> None:
    default = gravity.Gravity()
    assert default.source == "default" and default.value == 9.80665
    assert abs(gravity.somigliana(latitude) - default.value) < 2 * default.uncertainty


def test_unknown_height_costs_certainty() -> None:
    assert gravity.at(50, None).uncertainty > 3 * gravity.at(50, 100).uncertainty
    assert gravity.at(50, None).scale_uncertainty == pytest.approx(1.6e-4, rel=0.1)


@pytest.mark.parametrize(("latitude", "altitude"), [(91, 0), (-90.1, 0), (float("nan"), 0), (0, 90000)])
def test_off_the_earth_is_refused(latitude: float, altitude: float) -> None:
    with pytest.raises(gravity.LocationError):
        gravity.at(latitude, altitude)


def test_a_given_value_must_be_the_earths() -> None:
    assert gravity.given(9.81676, 1e-5).source == "given"
    with pytest.raises(gravity.LocationError, match="not found on the earth"):
        gravity.given(1.0)
