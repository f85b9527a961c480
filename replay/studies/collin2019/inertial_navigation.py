"""Strapdown inertial navigation: its error's growth, by grade and after calibration.

Collin et al. 2019, 2.2 and 3.1 (Eq. 6-11), with calib_core's mechanisation on simulated phones at rest. The
hour of 2.2 is navigated over a round Earth, on which gravity pulls back what has strayed (Schuler); height
is held.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.model import SensorModel
from stillcal.replay.phone import Scenario, load_phone, simulate
from stillcal.replay.phone.activities.resting import Rest
from stillcal.replay.studies import drawing
from stillcal.replay.studies.claim import Claim, Evidence, Progress, Study, agreement, holds, picture, table
from stillcal.replay.studies.collin2019.grades import GRADES
from stillcal.replay.studies.collin2019.pedestrian_tables import walk
from stillcal.replay.studies.methods.navigation import direction_cosines, strapdown

WORK = "Collin 2019"
NAUTICAL_MILE = 1852.0
G, EARTH_M = 9.80665, 6.371e6
DEG_H = math.radians(1.0) / 3600.0
REST_S, SETTLE_S = 420.0, 10.0
MARKS = (1.0, 10.0, 60.0, 300.0)


def growth(accelerometer: float, gyroscope: float, duration: float = 300.0) -> tuple[Array, Array]:
    """Return times (n,) s and horizontal position errors (n,) m of a rest with two constant biases."""
    t = np.arange(0.0, duration, 0.02)
    forces = np.tile([accelerometer, 0.0, G], (t.size, 1))
    track = strapdown(t, np.tile([0.0, gyroscope, 0.0], (t.size, 1)), forces, np.eye(3), G)
    return t, np.asarray(np.linalg.norm(track.position[:, :2], axis=1))


def power(t: Array, error: Array) -> float:
    """Return the power of time with which an error grows, over the last nine tenths."""
    rows = t > 0.1 * t[-1]
    return float(np.polyfit(np.log(t[rows]), np.log(error[rows]), 1)[0])


def hour_on_earth(accelerometer: float, gyroscope: float, duration: float = 3600.0) -> tuple[Array, Array]:
    """Return times s and position errors m of a rest on a round, still Earth: biases in m/s^2 and rad/s.

    Eq. 10-11 with gravity computed where the navigator believes to be; its size is that of the surface.
    """
    from scipy.integrate import solve_ivp  # noqa: PLC0415 - for those who evaluate

    def moved(t: float, state: Array) -> Array:
        turned = direction_cosines(np.array([0.0, gyroscope * t, 0.0]))
        place = state[:3] + np.array([0.0, 0.0, EARTH_M])
        pull = -G * place / np.linalg.norm(place)
        acceleration = turned @ np.array([accelerometer, 0.0, G]) + pull
        acceleration[2] = 0.0
        return np.asarray(np.r_[state[3:], acceleration])

    times = np.linspace(0.0, duration, 361)
    done = solve_ivp(moved, (0.0, duration), np.zeros(6), t_eval=times, rtol=1e-10, atol=1e-9)
    return times, np.asarray(np.linalg.norm(done.y[:2], axis=0))


def phone_at_rest(grade: str, seed: int) -> tuple[Array, Array, Array, Array]:
    """Return t and position errors raw, with the true affine errors taken out, and also zeroed, (n,) s and m.

    The attitude at the start is the true one. Zeroed: the mean rate of the first two minutes is taken off.
    """
    simulation = simulate(Scenario(segments=(Rest(duration_s=REST_S + 130.0),)), load_phone(grade), seed)
    whole, truth = simulation.whole(), simulation.truth
    assert whole.gyroscope is not None, "the grades have gyroscopes"
    assert truth.gyroscope is not None, "the grades have gyroscopes"
    rest = max(truth.rests, key=lambda r: r.t_end - r.t_start)
    begin = rest.t_start + SETTLE_S
    before = whole.gyroscope.between(begin, begin + 120.0).xyz
    forces = whole.accelerometer.between(begin + 120.0, rest.t_end)
    rates = whole.gyroscope.between(begin + 120.0, rest.t_end).xyz[: len(forces)]
    accel = SensorModel.of(truth.accelerometer.scale, truth.accelerometer.bias)
    gyro = SensorModel.of(truth.gyroscope.scale, truth.gyroscope.bias)
    cases = (
        (forces.xyz, rates),
        (accel.apply(forces.xyz), gyro.apply(rates)),
        (accel.apply(forces.xyz), gyro.apply(rates) - gyro.apply(before).mean(axis=0)),
    )
    t = forces.t - forces.t[0]
    tracks = [strapdown(t, w, f[: len(w)], rest.attitude, rest.gravity).position for f, w in cases]
    raw, calibrated, zeroed = (np.asarray(np.linalg.norm(p, axis=1)) for p in tracks)
    return t, raw, calibrated, zeroed


def study(data: Path | None, figures: Path, seed: int, progress: Progress) -> Study:
    """Powers of growth, the navigation grade's hour, and each grade's phone at rest."""
    claims = [*_growth_claims(), _hour_claim()]
    curves = {}
    for number, grade in enumerate(GRADES):
        curves[grade] = phone_at_rest(grade, seed)
        progress((number + 1) / (len(GRADES) + 1))
    claims += [_grade_claim(curves), _steps_claim(curves["consumer"], by_steps(60.0))]
    rows = []
    for grade, (t, *errors) in curves.items():
        for name, error in zip(("raw", "affine errors out", "and zeroed"), errors, strict=True):
            rows.append((grade, name, *(_metres(float(np.interp(mark, t, error))) for mark in MARKS)))
    head = ("grade", "", *(f"{mark:.0f} s" for mark in MARKS))
    text = (
        "Position error, m, of simulated phones at rest, attitude at the start known. Affine errors are the\n"
        "true bias and scale: what is left is noise, which a perfect calibration leaves; zeroing takes the\n"
        f"mean rate of two minutes before off as well.\n\n{table(head, rows)}\n\n"
        + picture(
            _draw(curves, figures), "Growth of position errors: of single biases, and of each grade at rest"
        )
    )
    return Study(
        "inertial-navigation", "Inertial navigation", tuple(claims), text, ("inertial-navigation.png",), seed
    )


def _growth_claims() -> list[Claim]:
    accel = power(*growth(1e-3, 0.0))
    gyro = power(*growth(0.0, 1e-5))
    data = "calib_core's mechanisation, 300 s at rest"
    return [
        Claim(
            WORK,
            "3.1",
            "an error of a rate makes a position error that grows with time cubed",
            "power 3",
            f"power {gyro:.3f}",
            data,
            agreement(3.0, gyro, 0.01),
            "within 0.01: theory is exact",
            evidence=Evidence.THEORY,
        ),
        Claim(
            WORK,
            "3.1",
            "double integration: an error of a force grows with time squared",
            "power 2",
            f"power {accel:.3f}",
            data,
            agreement(2.0, accel, 0.01),
            "within 0.01: theory is exact",
            evidence=Evidence.THEORY,
        ),
    ]


def _hour_claim() -> Claim:
    found = {
        grade: float(hour_on_earth(mg * 1e-3 * G, deg_h * DEG_H)[1].max())
        for grade, mg, deg_h in (("navigation", 0.03, 0.005), ("tactical", 1.0, 1.0))
    }
    return Claim(
        WORK,
        "2.2",
        "navigation grade: not more than a nautical mile after an hour; tactical grade: minutes only",
        "1.85 km",
        ", ".join(f"{grade} {error / 1000:.2f} km" for grade, error in found.items()),
        "biases of Table 1 over a round Earth",
        holds(found["navigation"] <= NAUTICAL_MILE < found["tactical"]),
        "the largest error within the hour is below a mile for the one, above for the other",
        evidence=Evidence.THEORY,
    )


def _metres(error: float) -> str:
    """Return three digits without an exponent, from micrometres to thousands of kilometres."""
    digits = max(0, 2 - math.floor(math.log10(max(error, 1e-6))))
    return f"{error:,.{digits}f}"


def _grade_claim(curves: dict[str, tuple[Array, Array, Array, Array]]) -> Claim:
    at = {grade: float(np.interp(60.0, t, raw)) for grade, (t, raw, *_) in curves.items()}
    return Claim(
        WORK,
        "2.2, 3.1",
        "consumer sensors cannot navigate by integration: error after a minute",
        "not capable",
        ", ".join(f"{grade} {_metres(at[grade])} m" for grade in reversed(GRADES)),
        "simulated phones of Table 1",
        holds(at["consumer"] > 100.0 > at["tactical"] > at["navigation"]),
        "at rest; position error over 100 m within a minute, and in the order of the grades",
        evidence=Evidence.SIMULATION,
    )


def by_steps(duration: float) -> float:
    """Return how far off dead reckoning by steps is after so many seconds, m.

    The gyroscope has Table 1's consumer bias, raw; steps are 3 % too long, the worst of the best models'
    errors (3.3).
    """
    walked = walk(duration, bias=1000.0 * DEG_H)
    return float(np.linalg.norm(1.03 * walked.estimated[-1] - walked.true[-1]))


def _steps_claim(consumer: tuple[Array, Array, Array, Array], steps: float) -> Claim:
    t, *errors = consumer
    raw, affine, zeroed = (float(np.interp(60.0, t, error)) for error in errors)
    return Claim(
        WORK,
        "3.1, 3.4",
        "on foot, dead reckoning by steps is superior to integration",
        "superior",
        f"after a minute {_metres(steps)} m by steps, {_metres(raw)} m by integration",
        "simulated phone of Table 1, consumer grade",
        holds(steps < min(raw, affine, zeroed)),
        "by steps: the gyroscope raw, steps 3 % too long. Holds where that is nearer than integration even at"
        f" rest with affine errors out ({_metres(affine)} m) or zeroed ({_metres(zeroed)} m)",
        evidence=Evidence.SIMULATION,
    )


def _draw(curves: dict[str, tuple[Array, Array, Array, Array]], figures: Path) -> str:
    figure, (left, right) = drawing.panels(2)
    for label, biases in (("1 mg", (1e-3 * G, 0.0)), ("20 deg/h", (0.0, 20.0 * DEG_H))):
        t, error = growth(*biases)
        left.loglog(t[50:], error[50:], label=f"bias of {label}")
    left.set(xlabel="time, s", ylabel="position error, m")
    left.legend()
    for colour, (grade, (t, *errors)) in zip(drawing.COLOURS, curves.items(), strict=False):
        for style, error in zip(("-", "--", ":"), errors, strict=True):
            right.loglog(t[50::50], error[50::50], style, color=colour, label=grade if style == "-" else None)
    for style, name in (("--", "affine errors out"), (":", "and zeroed")):
        right.plot([], [], style, color="black", label=name)
    right.set(xlabel="time, s", ylabel="position error, m")
    right.legend(fontsize="small")
    return drawing.save(figure, figures, "inertial-navigation")
