"""Error processes have the spectra of their equations; grades are those of Table 1."""

import numpy as np
import pytest

from stillcal.replay.phone import load_phone
from stillcal.replay.studies.collin2019.grades import GRADES, TABLE1, measure, settings_of
from stillcal.replay.studies.collin2019.noise_processes import (
    BANK_ROOM,
    autoregressive,
    difference_spectrum,
    gauss_markov,
    spectra,
)


@pytest.fixture(scope="module")
def found() -> dict[str, object]:
    return {s.name: s for s in spectra(5, 2**18)}


@pytest.mark.parametrize("name", ["Gauss-Markov", "random walk", "autoregressive, two values", "1/f"])
def test_spectrum_is_that_of_the_equation(found: dict, name: str) -> None:
    room = BANK_ROOM if name == "1/f" else 0.0
    assert abs(found[name].ratio - 1.0) <= 4.0 * found[name].error + room


def test_wrong_theory_is_noticed(found: dict) -> None:
    walk = found["random walk"]
    steeper = type(walk)(walk.name, walk.f, walk.power, walk.theory / walk.f**0.1, walk.segments)
    assert abs(steeper.ratio - 1.0) > 4.0 * steeper.error


def test_difference_spectrum_of_nothing_is_white_and_integrates_to_the_variance() -> None:
    f = np.linspace(0.0, 5.0, 1001)
    assert difference_spectrum((), 0.1)(f) == pytest.approx(0.2)
    values = autoregressive((0.5,), np.random.default_rng(1), 100_000)
    assert values.var() == pytest.approx(1.0 / 0.75, rel=0.02)  # AR(1); 0.5 % is one error


def test_gauss_markov_keeps_a_third_after_its_correlation_time() -> None:
    values = gauss_markov(1.0, 3, 400_000)
    lag = 20  # one correlation time of the 0.05 s grid
    kept = np.mean(values[lag:] * values[:-lag]) / np.mean(values**2)
    assert kept == pytest.approx(np.exp(-1.0), abs=0.02)  # 30,000 correlation times on each of three axes


@pytest.mark.parametrize(("number", "grade"), list(enumerate(GRADES)))
def test_phone_of_a_grade_has_the_figures_of_table_1(number: int, grade: str) -> None:
    assert settings_of(load_phone(grade), grade) == pytest.approx(
        [r[number] for r in TABLE1.values()], rel=0.025
    )


def test_random_walk_measured_at_rest_is_the_grade_s() -> None:
    measured = measure("tactical", 1, duration=600.0)
    assert measured.random_walk == pytest.approx(0.1, rel=max(0.01, 3.0 * measured.random_walk_error))
    assert measured.accelerometer_noise == pytest.approx(50.0, rel=0.02)
