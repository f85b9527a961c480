"""Lines of one motor say that they are one, also where they fold back."""

from __future__ import annotations

import numpy as np

from stillcal.calib_core.arrays import frozen
from stillcal.calib_core.diagnosis.noise.lines.line import middle_hz
from stillcal.calib_core.diagnosis.noise.lines.spectral_line import tones
from stillcal.calib_core.streams.samples import Samples, Sensor

T = np.arange(0.0, 300.0, 0.01)


def remarks(*frequencies: float, takes_turns: bool = False) -> dict[float, str]:
    """Return what is remarked of each line found, by frequency, Hz; made are sines of these frequencies.

    takes_turns: whether each is there for its own part of the time.
    """
    xyz = np.random.default_rng(4).normal(0.0, 0.01, (T.size, 3))
    turn = (T // (T[-1] / len(frequencies) + 0.01)).astype(int)
    there = np.arange(len(frequencies))[:, None] == turn if takes_turns else 1.0
    xyz[:, 2] += 9.81 + 0.01 * (there * np.sin(2.0 * np.pi * np.outer(frequencies, T))).sum(axis=0)
    found = tones(Samples(Sensor.ACCELEROMETER, frozen(T), frozen(xyz)), "accel")
    return {round(middle_hz(f), 1): f.remark for f in found}


def test_harmonics_belong_to_their_vibration_also_folded_back() -> None:
    said = remarks(17.3, 34.6, 69.2)
    assert said[17.3].startswith("It has harmonics: 2 at 34.6 Hz, 4 at 30.8 Hz.")
    assert said[34.6] == "It is harmonic 2 of the vibration at 17.3 Hz."
    assert said[30.8] == "It may be harmonic 4 of the vibration at 17.3 Hz, 69.2 Hz folded back."


def test_a_multiple_at_another_time_is_no_harmonic() -> None:
    said = remarks(17.3, 34.6, takes_turns=True)
    assert len(said) == 2 and all(text.startswith("It may be an alias") for text in said.values())


def test_lines_that_are_no_multiples_say_only_what_they_may_alias() -> None:
    assert all(text.startswith("It may be an alias") for text in remarks(17.3, 34.2, 41.7).values())
