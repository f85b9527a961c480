"""Sensor grades: the simulated phones of Table 1 against its figures, by their settings and as measured.

Collin et al. 2019, 2.2. Measured: what ten minutes on a table and an Allan fit show of each ready phone.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.gravity import STANDARD
from stillcal.calib_core.noise.allan import allan_curve, fit_allan
from stillcal.replay.phone import Phone, Scenario, load_phone, simulate
from stillcal.replay.phone.activities.resting import Rest
from stillcal.replay.phone.settings import SensorSettings, per_axis
from stillcal.replay.studies.claim import Claim, Evidence, Progress, Study, Verdict, holds, table
from stillcal.replay.studies.har.devices import read_devices

WORK = "Collin 2019"
GRADES = ("navigation", "tactical", "consumer")
MG, DEG_H, DEG_RT_H = STANDARD / 1e3, math.radians(1.0) / 3600.0, math.radians(1.0) / 60.0
REST_S = 3600.0

TABLE1: dict[str, tuple[float, float, float]] = {
    "accelerometer bias, mg": (0.03, 1.0, 30.0),
    "accelerometer noise density, ug/sqrt(Hz)": (10.0, 50.0, 100.0),
    "accelerometer scale factor error, %": (0.01, 0.03, 1.0),
    "accelerometer misalignment, mrad; consumer: cross-axis, %": (0.05, 0.5, 1.0),
    "gyroscope bias, deg/h": (0.005, 1.0, 1000.0),
    "gyroscope bias instability, deg/h": (0.003, 0.1, 20.0),
    "gyroscope angular random walk, deg/sqrt(h)": (0.002, 0.1, 0.5),
    "gyroscope scale factor error, %": (0.0005, 0.01, 1.0),
    "gyroscope misalignment, mrad; consumer: cross-axis, %": (0.01, 0.5, 1.0),
}
"""Table 1 as printed: navigation, tactical, consumer."""

ORDER = math.sqrt(10.0)
"""Half an order of magnitude either way."""


@dataclass(frozen=True, slots=True)
class Measured:
    """What a recording at rest shows of a phone, in Table 1's units; means over axes."""

    accelerometer_noise: float
    gyroscope_bias: float
    random_walk: float
    random_walk_error: float


def settings_of(phone: Phone, grade: str) -> tuple[float, ...]:
    """Return a phone's settings in the order and units of Table 1."""
    assert phone.gyro is not None, "the grades have gyroscopes"
    accel, gyro = phone.accel, phone.gyro
    cross = 100.0 if grade == "consumer" else 1000.0  # percent or mrad
    return (
        _mean(accel.bias) / MG,
        float(per_axis(accel.noise.white).mean()) / MG * 1e3,
        100.0 * _scale_error(accel),
        cross * _cross_axis(accel),
        _mean(gyro.bias) / DEG_H,
        float(per_axis(gyro.noise.flicker).mean()) / DEG_H,
        float(per_axis(gyro.noise.white).mean()) / math.sqrt(2.0) / DEG_RT_H,
        100.0 * _scale_error(gyro),
        cross * _cross_axis(gyro),
    )


def measure(grade: str, seed: int, duration: float = REST_S) -> Measured:
    """Record a phone of a grade at rest and measure its noise and gyroscope bias from the recording alone."""
    whole = simulate(Scenario(segments=(Rest(duration_s=duration),)), load_phone(grade), seed).whole()
    assert whole.gyroscope is not None, "the grades have gyroscopes"
    still = whole.accelerometer.t > 60.0  # past the putting down
    rate = len(whole.accelerometer) / whole.accelerometer.t[-1]
    forces, rates = whole.accelerometer.xyz[still], whole.gyroscope.xyz[whole.gyroscope.t > 60.0]
    accel = [fit_allan(allan_curve(column, rate)) for column in forces.T]
    gyro = [fit_allan(allan_curve(column, rate)) for column in rates.T]
    return Measured(
        float(np.mean([f.N for f in accel])) * math.sqrt(2.0) / MG * 1e3,
        float(np.abs(rates.mean(axis=0)).mean()) / DEG_H,
        float(np.mean([f.N for f in gyro])) / DEG_RT_H,
        float(np.mean([f.errors[0] for f in gyro])),
    )


def study(data: Path | None, figures: Path, seed: int, progress: Progress) -> Study:
    """Compare Table 1's consumer grade with real phones; show what each simulated grade measures at rest."""
    rows = []
    for number, grade in enumerate(GRADES):
        measured = measure(grade, seed)
        held, printed = settings_of(load_phone(grade), grade), [row[number] for row in TABLE1.values()]
        off = max(abs(a / b - 1.0) for a, b in zip(held, printed, strict=True))
        rows.append(
            (
                grade,
                f"{measured.accelerometer_noise:.4g}",
                f"{measured.gyroscope_bias:.4g}",
                f"{measured.random_walk:.4g}",
                f"{off:.1%}",
            )
        )
        progress((number + 1) / (len(GRADES) + 1))
    claims = tuple(_real_claims(data))
    head = (
        "grade",
        "accelerometer noise, ug/sqrt(Hz)",
        "gyroscope bias, deg/h",
        "random walk, deg/sqrt(h)",
        "file off Table 1 by",
    )
    text = f"{_ROUND_TRIP.format(REST_S / 3600)}\n\n{table(head, rows)}"
    return Study("grades", "Sensor grades", claims, text, (), seed)


_ROUND_TRIP = """The simulated phones of the three grades hold the figures of Table 1, which proves nothing of
Table 1. What a recording of them at rest gives back ({:.0f} h, 100 Hz) shows that simulator and Allan fit
agree:"""


def real_consumers(data: Path) -> dict[str, Array]:
    """Return what the accelerometers of real phones and watches measure, (devices,), in Table 1's units.

    Noise is the standard deviation of the samples at rest over the square root of half the rate; it holds
    quantisation and slow wander as well.
    """
    devices = read_devices(data)
    off = ~np.eye(3, dtype=bool)
    noise = [
        float(np.mean([r.accel.std(axis=0).mean() for r in d.rests])) * math.sqrt(2.0 / d.rate_hz)
        for d in devices
    ]
    return {
        "accelerometer bias, mg": np.array([np.abs(d.bias).mean() / MG for d in devices]),
        "accelerometer noise density, ug/sqrt(Hz)": np.array(noise) / MG * 1e3,
        "accelerometer scale factor error, %": np.array(
            [100.0 * np.abs(np.diag(d.forward) - 1.0).mean() for d in devices]
        ),
        "accelerometer misalignment, mrad; consumer: cross-axis, %": np.array(
            [100.0 * np.abs(d.forward[off]).mean() for d in devices]
        ),
    }


def _real_claims(data: Path | None) -> list[Claim]:
    names = [name for name in TABLE1 if name.startswith("accelerometer")]
    found = None if data is None else real_consumers(data)
    claims = []
    for name in names:
        words = name.replace("misalignment, mrad; consumer: cross-axis", "cross-axis sensitivity")
        paper = TABLE1[name][GRADES.index("consumer")]
        if found is None:
            claims.append(
                Claim(
                    WORK,
                    "Table 1",
                    f"consumer grade: {words}",
                    f"{paper:g}",
                    "",
                    "none",
                    Verdict.UNTESTED,
                    "the real recordings are not here (--data)",
                    evidence=Evidence.NONE,
                )
            )
            continue
        claims.append(_consumer(words, paper, found[name]))
    return claims


def _consumer(words: str, paper: float, values: Array) -> Claim:
    """Judge what real devices measure, (devices,), by the table's figure."""
    low, middle, high = np.percentile(values, [25, 50, 75])
    return Claim(
        WORK,
        "Table 1",
        f"consumer grade: {words}",
        f"{paper:g}",
        f"{middle:.3g} (quartiles {low:.3g} to {high:.3g})",
        f"hhar_still: {values.size} real phones and watches",
        holds(of_order(float(middle), paper)),
        f"within a factor of {ORDER:.1f} of the median, half an order of magnitude: the table calls"
        " its figures indicative orders of magnitude",
        evidence=Evidence.REAL,
    )


def of_order(ours: float, paper: float) -> bool:
    """Return whether a figure is within half an order of magnitude of the table's."""
    return 1.0 / ORDER <= ours / paper <= ORDER


def _mean(values: tuple[float, float, float]) -> float:
    return float(np.abs(values).mean())


def _scale_error(sensor: SensorSettings) -> float:
    return float(np.abs(np.diag(np.asarray(sensor.scale)) - 1.0).mean())


def _cross_axis(sensor: SensorSettings) -> float:
    scale: Array = np.asarray(sensor.scale)
    return float(np.abs(scale[~np.eye(3, dtype=bool)]).mean())
