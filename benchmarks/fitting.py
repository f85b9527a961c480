"""Item 4: one full fit of 40 rests and of 40 turns, beside scipy's least squares on the same cost."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from peers import peer
from subject import BIAS, FOLDER, phone
from timing import Row, ratio, rounds

from stillcal.calib_core.accelerometer import fit as accelerometer
from stillcal.calib_core.engine.engine import Engine
from stillcal.calib_core.engine.settings import EngineSettings, ScheduleSettings
from stillcal.calib_core.gyroscope import fit as gyroscope
from stillcal.calib_core.streams.events import End
from stillcal.replay.phone import draw_rests, load_scenario, simulate

_SCENARIO = """description = "41 attitudes by hand"
[[segment]]
activity = "rest"
duration_s = 50.0
[[segment]]
activity = "poses"
count = 41
rest_s = [8.0, 12.0]
"""


def run(quick: bool) -> Iterator[Row]:
    """Yield the rows of item 4."""
    count = 10 if quick else 60
    yield _rests(count)
    yield from _turns(2 if quick else 5)


def _rests(count: int) -> Row:
    """Fit nine parameters: the search alone is what scipy does; ours also weighs, drops and judges."""
    from scipy.optimize import least_squares  # noqa: PLC0415 - the peer

    drawn = draw_rests(phone(), 40, 0)
    raw, sd, g = drawn.forces, drawn.white_uncertainties, drawn.gravity

    def cost(v: np.ndarray) -> np.ndarray:
        scale = np.diag(v[3:6])
        scale[0, 1] = scale[1, 0] = v[6]
        scale[0, 2] = scale[2, 0] = v[7]
        scale[1, 2] = scale[2, 1] = v[8]
        norms = np.linalg.norm((raw - v[:3]) @ scale.T, axis=1)
        return np.asarray((norms**2 - g**2) / (2.0 * g) / sd.mean(axis=1))

    start = np.r_[np.zeros(3), np.ones(3), np.zeros(3)]
    timed = rounds(
        {
            "ours": lambda: accelerometer.fit(raw, sd, g, parameters=9),
            "scipy": lambda: least_squares(cost, start, method="lm").x,
        },
        count,
        3,
    )
    fit, other = timed["ours"].answer, timed["scipy"].answer
    apart = float(np.max(np.abs(fit.values - other) / np.sqrt(np.diag(fit.covariance))))
    off = np.abs(fit.model.bias - BIAS).max()
    return Row(
        "4",
        "full fit of 40 rests, weights, outliers and coverage with it",
        timed["ours"].spread(1e3),
        "ms",
        "scipy.least_squares, the search alone",
        ratio(timed["ours"], timed["scipy"]),
        "at most 3 ms",
        timed["ours"].median <= 3e-3,
        f"bias off by {off:.1e} m/s^2; apart by {apart:.2f} standard errors",
        3e-3 / timed["ours"].median,
    )


def _turns(count: int) -> Iterator[Row]:
    file = FOLDER / "poses.toml"
    FOLDER.mkdir(parents=True, exist_ok=True)
    file.write_text(_SCENARIO)
    whole = simulate(load_scenario(str(file)), phone(), 0).whole()
    engine = Engine(EngineSettings(schedule=ScheduleSettings(watch="continuous")))
    assert whole.gyroscope is not None
    engine.feed(whole.gyroscope, whole.accelerometer, End(whole.t_end))
    turns, record = engine.state.pool.turns[:40], engine.state.record
    assert record is not None and record.accelerometer is not None
    model, g = record.accelerometer.model, record.accelerometer.gravity
    fit = gyroscope.fit(turns, model, g)
    from scipy.optimize import least_squares  # noqa: PLC0415 - the peer

    def cost(v: np.ndarray) -> np.ndarray:
        return gyroscope.residuals(turns, model, v[:9].reshape(3, 3), v[9:])

    start = np.r_[np.eye(3).ravel(), np.zeros(3)]
    timed = rounds(
        {
            "ours": lambda: gyroscope.fit(turns, model, g),
            "scipy": lambda: least_squares(cost, start, max_nfev=20).x,
        },
        count,
    )
    left = np.degrees(fit.rms_after)
    yield Row(
        "4",
        f"full fit of {len(turns)} turns, {fit.parameters.name}",
        timed["ours"].spread(1e3),
        "ms",
        "scipy.least_squares on the same residuals, numerical slopes",
        ratio(timed["ours"], timed["scipy"]),
        accuracy=f"{left:.3f} deg rms a turn left, bias off by {_gyro_off(fit.model.bias):.1e} rad/s",
    )
    vqf = peer("vqf")
    if vqf is not None:
        n = min(len(whole.gyroscope), len(whole.accelerometer))
        gyro, accel = (np.ascontiguousarray(s.xyz[:n]) for s in (whole.gyroscope, whole.accelerometer))
        estimate = vqf.VQF(0.02)
        estimate.updateBatch(gyro, accel)
        off = _gyro_off(estimate.getBiasEstimate()[0])
        yield Row(
            "4",
            "gyroscope bias from the same ten minutes",
            _gyro_off(fit.model.bias),
            "rad/s off",
            "vqf",
            accuracy=f"vqf: {off:.1e} rad/s off",
        )


def _gyro_off(bias: np.ndarray) -> float:
    return float(np.abs(np.asarray(bias) - (0.01, -0.02, 0.005)).max())
