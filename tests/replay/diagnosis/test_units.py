"""Numbers are shown in the units that people read, each with the factor from SI."""

from __future__ import annotations

import pytest

from stillcal.replay.diagnosis.words.units import plain, shown_in

G = 9.80665


@pytest.mark.parametrize(
    ("value", "unit", "name", "shown"),
    [
        (1.2, "m/s^2", "bias", (1.2e3 / G, "mg")),
        (2e-5, "m/s^2", "bias", (20.0 / G, "µg")),
        (6e-3, "m/s^2/K", "slope", (6.0 / G, "mg/K")),
        (1e-3, "rad/s", "bias", (0.0572958, "deg/s")),
        (1e-6, "rad/s", "bias", (0.206265, "deg/h")),
        (1e-3, "m/s^2/sqrt(Hz)", "density", (1.0 / G, "mg/√Hz")),
        (4.3e-4, "s", "sigma", (0.43, "ms")),
        (300.0, "s", "tau_s", (300.0, "s")),
        (0.03, "m", "position", (30.0, "mm")),
        (0.0123, "1", "scale", (1.23, "%")),
        (3e-5, "1", "relative", (30.0, "ppm")),
        (0.3, "1", "relative", (30.0, "%")),
        (1.6, "1", "ratio", (1.6, "")),
        (5e-5, "rad/s/K", "slope", (0.00286479, "deg/s/K")),
        (1e-5, "m/s^2/K^2", "quadratic", (0.00101972, "mg/K²")),
        (17.0, "Hz", "frequency", (17.0, "Hz")),
        (2e-4, "(rad/s)/(m/s^2)", "matrix", (0.112376, "deg/s/g")),
    ],
)
def test_a_value_is_shown_in_a_unit_of_its_size(
    value: float, unit: str, name: str, shown: tuple[float, str]
) -> None:
    factor, text = shown_in(value, unit, name)
    assert (value * factor, text) == (pytest.approx(shown[0], rel=1e-4), shown[1])


@pytest.mark.parametrize(
    ("value", "error", "text"),
    [
        (8000.13, 0.09, "8000.130 ± 0.090"),
        (118.0, 163.0, "120 ± 160"),
        (-0.1092, 0.0321, "-0.109 ± 0.032"),
        (137.2, None, "137"),
        (8000.0, None, "8000"),
        (-0.0, 0.5, "0.00 ± 0.50"),
        (0.05725, None, "0.0573"),
        (2.5e-6, 1.2e-7, "2.5e-06 ± 1.2e-07"),
        (0.0, None, "0"),
    ],
)
def test_a_number_is_written_in_plain_digits_as_many_as_its_error_leaves(
    value: float, error: float | None, text: str
) -> None:
    assert plain(value, error) == text
