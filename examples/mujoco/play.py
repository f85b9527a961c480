"""Carry a phone through attitudes in MuJoCo and record its IMU: python play.py SENSOR.toml OUT.csv.

MuJoCo gives the true specific force (m/s^2) and rate (rad/s) of a phone in a gimbal, whose three servos take
it from one attitude to the next. SENSOR.toml says what errors the sensor puts on them: bias, scale and white
noise, a gyroscope bias that follows temperature, and its sensitivity to force. Nothing here is taken from
stillcal but the layout of that file and of the recording.
"""

from __future__ import annotations

import sys
import tomllib
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

HERE = Path(__file__).parent
ATTITUDES, HOLD_S, TURN_S = 26, 18.0, 2.0
AMBIENT_C, RISE_K, TAU_S = 22.0, 12.0, 200.0
"""The board warms up from the ambient temperature after the start."""


def carried(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return times (n,), true specific force (n, 3) and true rate (n, 3) of the phone in the gimbal."""
    model = mujoco.MjModel.from_xml_path(str(HERE / "imu.xml"))
    data = mujoco.MjData(model)
    rng = np.random.default_rng(seed)
    steps = int(HOLD_S / model.opt.timestep), int(TURN_S / model.opt.timestep)
    rows = []
    last = np.zeros(3)
    for _ in range(ATTITUDES):
        target = rng.uniform([-np.pi, -1.4, -np.pi], [np.pi, 1.4, np.pi])
        smooth = 0.5 - 0.5 * np.cos(np.pi * np.arange(1, steps[1] + 1) / steps[1])
        for part in [*smooth, *np.ones(steps[0])]:
            data.ctrl[:] = last + part * (target - last)
            mujoco.mj_step(model, data)
            rows.append([data.time, *data.sensordata])
        last = target
    table = np.array(rows)
    return table[:, 0], table[:, 1:4], table[:, 4:7]


def measured(
    t: np.ndarray, force: np.ndarray, rate: np.ndarray, sensor: dict[str, Any], seed: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return temperature (n,) degC, and force and rate (n, 3) as the sensor reads them."""
    rng = np.random.default_rng(seed)
    temperature = AMBIENT_C + RISE_K * (1.0 - np.exp(-t / TAU_S))
    warmer = temperature - sensor.get("heat", {}).get("reference_c", 25.0)
    out = []
    for name, true in (("accel", force), ("gyro", rate)):
        own = sensor.get(name, {})
        white = np.broadcast_to(own.get("noise", {}).get("white", 0.0), 3)
        raw = true @ np.array(own.get("scale", np.eye(3))).T + np.array(own.get("bias", [0.0, 0.0, 0.0]))
        for effect in sensor.get("effect", []):
            if effect["name"] == f"{name}_bias_temperature":
                raw = raw + np.outer(warmer, effect["slope"])
            elif effect["name"] == "gyro_g_sensitivity" and name == "gyro":
                raw = raw + force @ np.array(effect["matrix"]).T
        # White noise of a one-sided density d scatters by d sqrt(f / 2) in samples at f Hz.
        deviation = white * np.sqrt(0.5 / np.median(np.diff(t)))
        out.append(raw + rng.normal(size=raw.shape) * deviation)
    return temperature, out[0], out[1]


def main(sensor_file: str, out: str, seed: int = 1) -> None:
    """Write a recording with the columns t, ax .. gz, temperature."""
    t, force, rate = carried(seed)
    sensor = tomllib.loads(Path(sensor_file).read_text())
    temperature, force, rate = measured(t, force, rate, sensor, seed)
    table = np.column_stack([t, force, rate, temperature])
    header = "t,ax,ay,az,gx,gy,gz,temperature"
    np.savetxt(out, table, delimiter=",", fmt="%.8g", header=header, comments="")


if __name__ == "__main__":
    main(*sys.argv[1:3])
