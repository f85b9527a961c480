"""Structure outside the catalogue: generic columns that compete under the name `unknown`.

They name no physics; where one of them wins, the answer says what is followed and stops there.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.model import settings as thresholds
from stillcal.calib_core.diagnosis.model.hypothesis import (
    TILTED,
    Entry,
    Hypothesis,
    Linear,
    Scene,
    curves,
    moves,
    no_hypotheses,
)
from stillcal.calib_core.diagnosis.slow import dictionaries as banks
from stillcal.calib_core.diagnosis.slow import regressors as drivers
from stillcal.calib_core.diagnosis.slow.effects_bias import SIZE, UNIT
from stillcal.calib_core.diagnosis.slow.effects_force import distinct, own_force, per_axis

STRETCH_CUTS = 14
GAIN = 0.02
SLOPE = 1e-3
SAY = "Unknown effect on the bias of {axes}; it follows "
GRID = {"t_start": "s", "t_end": "s", "period_s": "s"}


def unit_range(curve: Array) -> Array:
    """Return a curve about its mean, scaled so that it spans one."""
    return np.asarray((curve - curve.mean()) / max(float(np.ptp(curve)), 1e-12))


def _vibration(scene: Scene) -> list[drivers.Driver]:
    power = scene.bins.vibration
    size = max(float(np.median(power)), 1e-12) if power.size else 1.0
    return [({}, unit_range(power))] if moves(power / size, 1.0) else []


def _gain_of_a_stretch(entry: Entry, scene: Scene) -> list[Hypothesis]:
    """Another gain of each axis in a stretch of time."""
    if scene.up is None or scene.sensor != "accel" or distinct(scene.up) < 4:
        return []
    t, force = scene.bins.t, own_force(scene)
    cuts = np.linspace(*scene.bins.span, STRETCH_CUTS)
    found = []
    for i, a in enumerate(cuts):
        for b in cuts[i + 1 :]:
            inside = (t >= a) & (t < b)
            if 2 < inside.sum() < t.size - 2:
                columns = per_axis(scene, force * inside[:, None], TILTED)
                found.append(Hypothesis(entry, {"t_start": float(a), "t_end": float(b)}, columns))
    return found


def _gain_in_time(entry: Entry, scene: Scene) -> list[Hypothesis]:
    """Propose gains that grow with time, by so much in the whole recording."""
    if scene.up is None or scene.sensor != "accel" or distinct(scene.up) < 4:
        return []
    grown = unit_range(drivers.age(scene.bins))
    return [Hypothesis(entry, {}, per_axis(scene, own_force(scene) * grown[:, None], TILTED))]


def _crossed(entry: Entry, scene: Scene) -> list[Hypothesis]:
    """Propose what each axis and the next take up of each other's force, by temperature.

    The norm of gravity sees no more of misalignment than what the two axes have in common.
    """
    if scene.up is None or scene.sensor != "accel" or distinct(scene.up) < 4:
        return []
    force = own_force(scene)
    errors = np.zeros((len(force), 3, 3))
    for a, b in ((0, 1), (1, 2), (2, 0)):
        errors[:, a, a], errors[:, b, a] = 0.5 * force[:, b], 0.5 * force[:, a]
    return [
        Hypothesis(
            entry,
            grid,
            tuple(_seen(v.project, (errors * warm[:, None, None])[v.bins]) for v in scene.views),
        )
        for grid, warm in drivers.temperature(scene)
    ]


def _seen(project: Array, errors: Array) -> Array:
    return np.asarray(np.einsum("bni,nik->bnk", project, errors))


def _gravity_squared(entry: Entry, scene: Scene) -> list[Hypothesis]:
    """Rate by squares and products of gravity's components, the same five on each axis."""
    if scene.up is None or scene.sensor != "gyro" or distinct(scene.up) < 8:
        return []
    u = scene.up
    terms = np.stack(
        [u[:, 0] ** 2, u[:, 1] ** 2, u[:, 0] * u[:, 1], u[:, 0] * u[:, 2], u[:, 1] * u[:, 2]], axis=1
    )
    return [Hypothesis(entry, {}, tuple(_outer(v.project, terms[v.bins]) for v in scene.views))]


def _outer(project: Array, terms: Array) -> Array:
    both = project[:, :, :, None] * terms[None, :, None, :]
    return np.asarray(both.reshape(*both.shape[:2], -1))


def entries(sensor: str) -> list[Entry]:
    """Return the generic entries of one sensor."""
    direct = [
        ("vibration power", curves(_vibration), "amplitude", 3),
        ("attitude, nonlinearly", _gravity_squared, "amplitude", 15),
        ("own force in a stretch of time", _gain_of_a_stretch, "gain", 3),
        ("own force, with time", _gain_in_time, "gain", 3),
        ("temperature x another axis' force", _crossed, "slope", 3),
    ]
    banked = [
        ("temperature's past or bend", banks.thermal_past, 1),
        ("the past of charging or use", banks.other_pasts, 1),
        ("a stretch of time", banks.pulses, 1),
        ("two levels in time", banks.switches, 1),
        ("time from a moment on", banks.moments, 1),
        ("a period in time", banks.periods, 2),
        ("a sawtooth in time", banks.sawteeth, 1),
        ("time since the phone was moved", banks.since_moves, 1),
        ("time since the last change of attitude", banks.strains, 3),
    ]
    sizes = {"amplitude": (UNIT[sensor], SIZE[sensor]), "gain": ("1", GAIN), "slope": ("1/K", SLOPE)}

    def entry(follows: str, parameter: Linear) -> Entry:
        return Entry(
            "unknown",
            sensor,
            follows,
            no_hypotheses,
            (parameter,),
            SAY + follows + ".",
            grid_units=GRID,
            handicap=thresholds.UNKNOWN_HANDICAP,
        )

    found = [
        replace(entry(f, Linear(name, sizes[name][0], k, sizes[name][1])), propose=propose, by_row=k == 15)
        for f, propose, name, k in direct
    ]
    found += [
        replace(entry(f, Linear("amplitude", UNIT[sensor], 3 * q, SIZE[sensor])), bank=bank)
        for f, bank, q in banked
    ]
    return found
