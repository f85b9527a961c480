"""What the engine holds: samples that wait, rests and turns gathered from them, and gravity where it is.

Nothing here decides when to look or what becomes of what was gathered (engine.py, engine_judging.py).
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from stillcal.calib_core import gravity as local_gravity
from stillcal.calib_core.calibration.attitude_index import Crowd
from stillcal.calib_core.calibration.rest_pool import HeldRest
from stillcal.calib_core.engine.actions import Level
from stillcal.calib_core.engine.schedule import Watch
from stillcal.calib_core.engine.state import EngineSettings, EngineState, Move
from stillcal.calib_core.engine.telling import Telling
from stillcal.calib_core.gravity import Gravity, LocationError
from stillcal.calib_core.gyroscope.rotation_segment import Turn, make_turn
from stillcal.calib_core.static.detector import StationaryDetector
from stillcal.calib_core.static.rest import RestState
from stillcal.calib_core.streams.events import Location
from stillcal.calib_core.streams.samples import SampleError, Samples, Sensor

_SLACK_S = 60.0
"""How much longer than a turn and the rest that ends it the gyroscope is kept, s."""


class Holding:
    """Gathers into `state`. Streams are cut where they are told to be, never by how they came."""

    def __init__(
        self, settings: EngineSettings, state: EngineState, detector: StationaryDetector, telling: Telling
    ) -> None:
        self._settings, self._s, self._detector, self._telling = settings, state, detector, telling
        self._crowd = Crowd(settings.pool)

    def take(self, samples: Samples) -> None:
        """Let samples wait until they are looked at. Raises SampleError where their stream runs back."""
        s, sensor = self._s, samples.sensor
        if samples.t[0] < s.latest.get(sensor, -math.inf):
            raise SampleError(0, f"{sensor} at {samples.t[0]:.6f} s comes after {s.latest[sensor]:.6f} s")
        s.waiting[sensor] = Samples.joined([s.waiting[sensor], samples]) if sensor in s.waiting else samples
        s.latest[sensor] = float(samples.t[-1])

    def known_until(self) -> float:
        """Return the time (s) up to which both streams are known; -inf before the first sample."""
        s = self._s
        accel = s.latest.get(Sensor.ACCELEROMETER, -math.inf)
        gyro = s.latest.get(Sensor.GYROSCOPE, -math.inf)
        known = max(min(accel, gyro), accel - self._settings.schedule.gyro_patience_s)
        return known if s.heard is None else max(known, s.heard)

    def look(self, stop: float) -> None:
        """Pass the samples before `stop` to the detector and gather the rests it finds."""
        s = self._s
        due = [block for sensor in Sensor if len(block := self._before(sensor, stop))]
        if not due or s.watch is Watch.IDLE:
            return
        for block in due:
            if block.sensor is Sensor.GYROSCOPE and s.watch is Watch.CONTINUOUS:
                s.gyro_tail = block if s.gyro_tail is None else Samples.joined([s.gyro_tail, block])
        self.gather(self._detector.feed(*due))
        self._trim_tail()

    def gather(self, rests: Iterable[RestState]) -> None:
        """Take rests into the pool, and the turns between one and the next."""
        for rest in rests:
            self._gather(rest)

    def move_to(self, place: Location) -> None:
        """Take gravity from the place; what was gathered keeps that of where it was."""
        s = self._s
        if self._settings.schedule.gravity is not None:
            return
        try:
            found = local_gravity.at(place.latitude, place.altitude)
        except LocationError as error:
            self._telling.log(place.t, Level.WARNING, "location", f"location not used: {error}")
            return
        change = found.value - s.gravity.value
        if s.gravity.source == "default":
            s.pool = s.pool.located(found, place.t, self._settings.pool)
            s.attitudes = self._crowd.attitudes(s.pool)
        else:
            reach = place.t - self._settings.detector.max_rest_s - _SLACK_S
            s.moves = [*(m for m in s.moves if m.t >= reach), Move(place.t, s.gravity)]
        s.gravity = found
        self._telling.log(place.t, Level.INFO, "gravity", f"g is {found.value:.5f} m/s^2 here", change=change)

    def _before(self, sensor: Sensor, stop: float) -> Samples:
        """Take the samples before `stop` off those that wait."""
        waiting = self._s.waiting.get(sensor)
        if waiting is None or waiting.t[0] >= stop:
            return Samples.empty(sensor)
        cut = int(np.searchsorted(waiting.t, stop, side="left"))
        if cut == len(waiting):
            return self._s.waiting.pop(sensor)
        self._s.waiting[sensor] = waiting[cut:]
        return waiting[:cut]

    def _trim_tail(self) -> None:
        """Keep of the gyroscope what a turn may still need: its own length and the rest that ends it."""
        s, settings = self._s, self._settings
        if s.gyro_tail is not None and len(s.gyro_tail):
            reach = settings.turns.max_duration + settings.detector.max_rest_s + _SLACK_S
            s.gyro_tail = s.gyro_tail.between(float(s.gyro_tail.t[-1]) - reach, math.inf)

    def _gather(self, rest: RestState) -> None:
        s = self._s
        s.pool = self._crowd.grown(s.pool, HeldRest(rest, self._gravity_at(rest.t_end)))
        s.attitudes = self._crowd.attitudes(s.pool)
        s.fresh += 1
        s.counters.rests += 1
        if s.last_rest is not None and s.gyro_tail is not None:
            turn = make_turn(s.last_rest, rest, s.gyro_tail, self._settings.turns)
            if isinstance(turn, Turn):
                s.pool = s.pool.with_turn(turn, self._settings.pool)
                s.counters.turns += 1
        s.last_rest = rest
        self._telling.log(rest.t_end, Level.DEBUG, "rest", f"lay still for {rest.duration:.1f} s", n=rest.n)

    def _gravity_at(self, t: float) -> Gravity:
        """Return gravity of where the phone was at t (s): a rest may close after it was told of moves."""
        return next((move.left for move in self._s.moves if t <= move.t), self._s.gravity)
