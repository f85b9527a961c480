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
from stillcal.replay.phone.resting_activities import Rest
from stillcal.replay.phone.settings import SensorSettings, per_axis
from stillcal.replay.studies.claim import Claim, Progress, Study, Verdict, holds, table

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
    """Compare each grade's phone with Table 1; then what is measured of it at rest."""
    claims, rows = [], []
    for number, grade in enumerate(GRADES):
        ours, paper = settings_of(load_phone(grade), grade), [row[number] for row in TABLE1.values()]
        claims.append(_settings_claim(grade, paper, ours))
        measured = measure(grade, seed)
        claims += _measured_claims(grade, paper, measured)
        rows.append(
            (grade, f"{measured.accelerometer_noise:.4g}", f"{measured.gyroscope_bias:.4g}",
             f"{measured.random_walk:.4g}")
        )  # fmt: skip
        progress((number + 1) / len(GRADES))
    claims.append(_gap_claim())
    head = ("grade", "accelerometer noise, ug/sqrt(Hz)", "gyroscope bias, deg/h", "random walk, deg/sqrt(h)")
    text = f"Measured from {REST_S / 3600:.0f} h at rest, 100 Hz:\n\n{table(head, rows)}\n\n{_LIMITS}"
    return Study("grades", "Sensor grades", tuple(claims), text, (), seed)


_LIMITS = """A recording at rest shows noise and the gyroscope's bias; bias of the accelerometer, scale and
misalignment it does not show, and of weight, volume and power (last rows of Table 1) nothing here knows."""


def _settings_claim(grade: str, paper: list[float], ours: tuple[float, ...]) -> Claim:
    off = max(abs(o / p - 1.0) for o, p in zip(ours, paper, strict=True))
    return Claim(
        WORK, "Table 1", f"{grade} grade: nine figures of the simulated phone", "as printed",
        f"within {off:.1%}", f"config/phones/{grade}.toml", holds(off <= 0.025),
        "within 2.5 %: half a step of the last of two digits",
    )  # fmt: skip


def _measured_claims(grade: str, paper: list[float], measured: Measured) -> list[Claim]:
    data = f"{REST_S / 3600:.0f} h of a simulated rest"
    rounding = _rounding(load_phone(grade))
    room = max(0.01, 3.0 * measured.random_walk_error) + rounding
    return [
        Claim(
            WORK, "Table 1", f"{grade}: angular random walk, deg/sqrt(h), measured", f"{paper[6]:g}",
            f"{measured.random_walk:.4g}", data, holds(abs(measured.random_walk / paper[6] - 1.0) <= room),
            f"within {room:.1%}: the fit's error, at least 1 %, and {rounding:.1%} by rounding",
        ),
        _bias_claim(grade, paper, measured, data),
    ]  # fmt: skip


def _rounding(phone: Phone) -> float:
    """Return by what share rounding, as white noise of lsb^2 / 12, adds to the gyroscope's white noise."""
    assert phone.gyro is not None, "the grades have gyroscopes"
    variance = float(per_axis(phone.gyro.noise.white).mean()) ** 2 * phone.gyro.rate_hz / 2.0
    return math.sqrt(1.0 + phone.gyro.lsb**2 / 12.0 / variance) - 1.0


def _bias_claim(grade: str, paper: list[float], measured: Measured, data: str) -> Claim:
    """Angular random walk and bias instability hide a bias that is smaller than they are."""
    unknown = math.hypot(paper[6] / math.sqrt(REST_S / 3600.0), paper[5])
    ours, printed = measured.gyroscope_bias, paper[4]
    hidden = unknown > printed
    verdict = Verdict.UNTESTED if hidden else holds(abs(ours - printed) <= 3.0 * unknown)
    return Claim(
        WORK, "Table 1", f"{grade}: gyroscope bias, deg/h, measured", f"{printed:g}", f"{ours:.4g}", data,
        verdict, f"noise leaves +-{unknown:.2g} deg/h open" + (", more than the bias" if hidden else ""),
    )  # fmt: skip


def _gap_claim() -> Claim:
    decades = [math.log10(row[2] / row[0]) for name, row in TABLE1.items() if "misalignment" not in name]
    return Claim(
        WORK, "2.2", "the gap between consumer and navigation grades is many decades", "many decades",
        f"{min(decades):.1f} to {max(decades):.1f} decades", "Table 1", holds(max(decades) >= 3.0),
        "at least three decades in some figure",
    )  # fmt: skip


def _mean(values: tuple[float, float, float]) -> float:
    return float(np.abs(values).mean())


def _scale_error(sensor: SensorSettings) -> float:
    return float(np.abs(np.diag(np.asarray(sensor.scale)) - 1.0).mean())


def _cross_axis(sensor: SensorSettings) -> float:
    scale: Array = np.asarray(sensor.scale)
    return float(np.abs(scale[~np.eye(3, dtype=bool)]).mean())
