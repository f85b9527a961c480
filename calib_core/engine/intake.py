"""The engine's intake: samples that wait, rests and rotation segments gathered from them, local gravity.

When to look at the samples is decided in engine.py, what follows from the rests in decisions.py.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import msgspec
import numpy as np

from stillcal.calib_core import gravity as local_gravity
from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.calibration.rest_pool import AttitudeIndex, HeldRest
from stillcal.calib_core.calibration.suspicion import innovation, suspected
from stillcal.calib_core.engine.actions import Action, Level, Log
from stillcal.calib_core.engine.sensor_faults import rate_fault, told, without_rates
from stillcal.calib_core.engine.settings import EngineSettings, Watch
from stillcal.calib_core.engine.state import EngineState, Move
from stillcal.calib_core.gravity import Gravity, LocationError
from stillcal.calib_core.gyroscope.rotation_segment import NoSegment, RotationSegment, cut_rotation_segment
from stillcal.calib_core.static.detector import StationaryDetector
from stillcal.calib_core.static.rest import RestState
from stillcal.calib_core.streams.events import Location
from stillcal.calib_core.streams.samples import SampleError, Samples, Sensor
from stillcal.calib_core.temperature.memory import Memory

_SLACK_S = 60.0
"""s: gyroscope samples are kept this much longer than a rotation segment and the rest that ends it may last.
A rest is reported only once its last window was judged, which waits up to max_lag_s (30 s by default)."""


ACCEL_PATIENCE_S = 600.0
"""s: where the gyroscope has gone on alone for so long, the accelerometer is no longer waited for."""

SILENT_SAMPLES = 500
"""Samples of the gyroscope without one of the accelerometer that show that the latter has stopped."""

LONGEST_STEP_S = 1.0
"""s: a longer step between samples is a pause, of which so much counts."""

MAX_MOVES = 64
"""Places of late that are remembered: a rest in which more were told has no one gravity."""


class Intake:
    """Gathers rests into the engine's `state`.

    Streams are cut at the times that the engine asks for, never at the borders of the blocks that came in.
    actions: what is to be logged is appended to this list.
    """

    def __init__(
        self,
        settings: EngineSettings,
        state: EngineState,
        detector: StationaryDetector,
        actions: list[Action],
    ) -> None:
        self._settings, self._state, self._detector, self._actions = settings, state, detector, actions
        self._index = AttitudeIndex(settings.pool)
        self._after_tail: list[Samples] = []
        self._alone, self._alone_since = 0, math.inf
        self._reach_s = settings.turns.max_duration + settings.detector.max_rest_s + _SLACK_S

    @property
    def accelerometer_silent(self) -> bool:
        """Whether the gyroscope sends samples and the accelerometer none."""
        return self._alone > SILENT_SAMPLES

    @property
    def accelerometer_never_came(self) -> bool:
        """Whether the gyroscope has gone on alone from the start for longer than it is waited for."""
        if Sensor.ACCELEROMETER in self._state.latest:
            return False
        looked_at_s = self._state.latest.get(Sensor.GYROSCOPE, -math.inf) - self._alone_since
        return max(looked_at_s, self._gyroscope_alone_s(-math.inf)) > ACCEL_PATIENCE_S

    def take(self, samples: Samples) -> None:
        """Keep samples until `look` takes them. Raises SampleError where their stream runs backwards."""
        state, sensor = self._state, samples.sensor
        if samples.t[0] < state.latest.get(sensor, -math.inf):
            raise SampleError(0, f"{sensor} at {samples.t[0]:.6f} s comes after {state.latest[sensor]:.6f} s")
        waiting = state.waiting.get(sensor)
        state.waiting[sensor] = samples if waiting is None else Samples.joined([waiting, samples])
        state.latest[sensor] = float(samples.t[-1])

    def hear(self, t: Array, celsius: Array) -> None:
        """Take readings of the thermometer, degC at times t (s), both (n,)."""
        before, now = self._state.thermometer.doubt, self._state.thermometer.with_readings(t, celsius)
        self._state.thermometer = now
        if now.doubt is not None and before is None:
            how_long = "ten minutes have" if now.doubt.from_first else "a day has"
            why = (
                f"the thermometer jumped to {now.doubt.celsius:.1f} degC, faster than a phone warms or cools"
                f": it is not followed until it has jumped back or {how_long} passed without a jump"
            )
            self._actions.append(Log(now.doubt.jumped_at, Level.WARNING, "thermometer", why))
        elif now.doubt is None and before is not None:
            self._actions.append(
                Log(float(now.t[-1]), Level.INFO, "thermometer", "the thermometer is followed again")
            )

    def known_until(self) -> float:
        """Return the time (s) up to which both streams are known; -inf before the first sample.

        A sensor that lags by more than its patience is no longer waited for.
        """
        state = self._state
        accel = state.latest.get(Sensor.ACCELEROMETER, -math.inf)
        gyro = state.latest.get(Sensor.GYROSCOPE, -math.inf)
        known = max(min(accel, gyro), accel - self._settings.schedule.gyro_patience_s)
        if self._gyroscope_alone_s(accel) > ACCEL_PATIENCE_S:
            known = max(known, gyro - ACCEL_PATIENCE_S)
        return known if state.heard is None else max(known, state.heard)

    def _gyroscope_alone_s(self, accel: float) -> float:
        """Return how long the gyroscope has gone on after `accel` (s), the accelerometer's newest stamp, s.

        Pauses are left out: after a night asleep either sensor may be the first to wake.
        """
        waiting = self._state.waiting.get(Sensor.GYROSCOPE)
        if waiting is None or waiting.t[-1] - max(accel, waiting.t[0]) <= ACCEL_PATIENCE_S:
            return 0.0
        return float(np.minimum(np.diff(waiting.t[waiting.t > accel]), LONGEST_STEP_S).sum())

    def look(self, stop: float) -> None:
        """Pass the samples before `stop` (s) to the detector and gather the rests that it returns."""
        state = self._state
        due = [block for sensor in Sensor if len(block := self._before(sensor, stop))]
        if not due:
            return
        if any(block.sensor is Sensor.ACCELEROMETER for block in due):
            self._alone, self._alone_since = 0, math.inf
        else:
            self._alone += sum(map(len, due))
            self._alone_since = min(self._alone_since, float(due[0].t[0]))
        if state.watch is Watch.IDLE:
            return
        for block in due:
            if state.watch is Watch.CONTINUOUS and block.temperature is not None:
                self.hear(block.t, block.temperature)
            if block.sensor is Sensor.GYROSCOPE and state.watch is Watch.CONTINUOUS:
                self._after_tail.append(block)
        self.gather(self._detector.feed(*due))
        if self._after_tail and self._after_tail[-1].t[-1] - self._after_tail[0].t[0] > self._reach_s:
            self.join_tail()

    def gather(self, rests: Iterable[RestState]) -> None:
        """Add rests to the pool, and the rotation segments between one rest and the next."""
        for rest in rests:
            self._gather(rest)

    def move_to(self, place: Location) -> None:
        """Take local gravity from a place; rests gathered before keep the gravity of their own place."""
        state = self._state
        if self._settings.schedule.gravity is not None:
            return
        try:
            gravity = local_gravity.at(place.latitude, place.altitude)
        except LocationError as error:
            self._actions.append(Log(place.t, Level.WARNING, "location", f"location not used: {error}"))
            return
        change = gravity.value - state.gravity.value
        if state.gravity.source == "default":
            state.pool = state.pool.located(gravity, place.t, self._settings.pool)
            state.memory = state.memory.at_gravity(gravity.value)
            state.attitudes = self._index.attitudes(state.pool)
        else:
            reach = place.t - self._settings.detector.max_rest_s - _SLACK_S
            moves = [*(m for m in state.moves if m.t >= reach), Move(place.t, state.gravity)]
            state.moves = moves[-MAX_MOVES:]
        state.gravity = gravity
        why = f"g is {gravity.value:.5f} m/s^2 here"
        self._actions.append(Log(place.t, Level.INFO, "gravity", why, {"change": change}))

    def _before(self, sensor: Sensor, stop: float) -> Samples:
        """Remove and return the waiting samples before `stop` (s)."""
        waiting = self._state.waiting.get(sensor)
        if waiting is None or waiting.t[0] >= stop:
            return Samples.empty(sensor)
        cut = int(np.searchsorted(waiting.t, stop, side="left"))
        if cut == len(waiting):
            return self._state.waiting.pop(sensor)
        self._state.waiting[sensor] = waiting[cut:]
        return waiting[:cut]

    def join_tail(self) -> None:
        """Bring the state's tail of gyroscope samples up to date, without what no segment can need any more.

        The samples of every look are joined only where the tail is needed, not copied again at each of them.
        """
        if self._after_tail:
            tail = self._state.gyro_tail
            runs = self._after_tail if tail is None else [tail, *self._after_tail]
            joined = Samples.joined(runs)
            self._state.gyro_tail = joined.between(float(joined.t[-1]) - self._reach_s, math.inf)
            self._after_tail = []

    def trim_tail(self) -> None:
        """Leave out of the tail what no segment can need, so that a saved state has no more than that.

        A segment begins in the last rest. A rest that is not closed yet may have ended within _SLACK_S.
        """
        self.join_tail()
        tail, last = self._state.gyro_tail, self._state.last_rest
        if tail is None:
            return
        late = float(tail.t[-1]) - _SLACK_S
        parts = [tail.between(late, math.inf)]
        if last is not None:
            begins = last.t_end - self._settings.turns.margin
            ends = begins + self._settings.turns.max_duration + LONGEST_STEP_S
            parts.insert(0, tail.between(begins, min(ends, late)))
        self._state.gyro_tail = Samples.joined(parts)

    def drop_tail(self) -> None:
        """Forget the last rest and the gyroscope since, because the stream is interrupted."""
        self._state.last_rest = self._state.gyro_tail = None
        self._after_tail = []

    def _gather(self, rest: RestState) -> None:
        state, middle = self._state, 0.5 * (rest.t_start + rest.t_end)
        if len(state.charger.t):
            rest = msgspec.structs.replace(rest, charged=state.charger.at(middle))
        if rest.temperature is not None:
            lagged = state.thermometer.lagged(middle, rest.temperature)
            rest = msgspec.structs.replace(rest, lagged=frozen(lagged))
            self.hear(np.array([middle]), np.array([rest.temperature]))
            if state.thermometer.doubts(middle):
                rest = msgspec.structs.replace(rest, temperature=None, lagged=None)
        rest = self._with_sound_rates(rest)
        state.pool = self._index.with_rest(state.pool, HeldRest(rest, self._gravity_at(rest.t_end)))
        state.attitudes = self._index.attitudes(state.pool)
        state.memory = state.memory.with_rest(rest, state.pool.held[-1].gravity.value)
        self._suspect()
        state.fresh += 1
        state.counters.rests += 1
        self.join_tail()
        if state.last_rest is not None and state.gyro_tail is not None and not state.rates_doubted:
            segment = cut_rotation_segment(state.last_rest, rest, state.gyro_tail, self._settings.turns)
            if isinstance(segment, RotationSegment):
                state.pool = state.pool.with_segment(segment, self._settings.pool)
                state.counters.turns += 1
            elif segment is NoSegment.UNDERSAMPLED:
                self._count_undersampled(rest)
        state.last_rest = rest
        why = f"lay still for {rest.duration:.1f} s"
        self._actions.append(Log(rest.t_end, Level.DEBUG, "rest", why, {"n": rest.n}))

    def _with_sound_rates(self, rest: RestState) -> RestState:
        """Return a rest, without its rates where they cannot be the gyroscope's bias; that is told once."""
        if rest.rate is None:
            return rest
        state, significance, before = self._state, self._settings.quality.significance, self._state.faults
        alone = Memory().with_rest(rest, self._gravity_at(rest.t_end).value)
        missed = None if state.record is None else innovation(state.record, Sensor.GYROSCOPE, alone)
        fault = rate_fault(rest, missed, state.pool.rests, significance)
        if bool(fault) is not bool(state.rates_doubted):
            state.rates_doubted, state.faults = fault, dict(before)
            state.faults.pop(Sensor.GYROSCOPE, None)
            if fault:
                state.faults[Sensor.GYROSCOPE] = fault
            self._actions += told(rest.t_end, before, state.faults)
        return without_rates(rest) if fault else rest

    def _suspect(self) -> None:
        """Compare the newest rest with what is stated of both biases."""
        state, significance = self._state, self._settings.quality.significance
        for sensor in Sensor:
            if state.record is None:
                return
            missed = innovation(state.record, sensor, state.memory.newest)
            before = state.suspected.get(sensor)
            after = None if missed is None else suspected(before, missed, significance)
            if missed is None or after is None:
                continue
            state.suspected = state.suspected | {sensor: after}
            if before is None:
                why = f"one rest misses the {sensor}'s bias: it is uncertain until later rests decide"
                figures = {"missed": float(np.abs(missed.missed).max())}
                self._actions.append(Log(float(state.memory.t[-1]), Level.INFO, "suspected", why, figures))

    def _count_undersampled(self, rest: RestState) -> None:
        """Count a turn that the gyroscope's samples cannot follow, ended by `rest`; say so the first time."""
        counters = self._state.counters
        counters.undersampled += 1
        if counters.undersampled == 1:
            why = f"{NoSegment.UNDERSAMPLED}: sample faster, or its scale stays as it is"
            rate = rest.n / max(rest.duration, 1e-9)
            self._actions.append(
                Log(rest.t_end, Level.WARNING, "undersampled", why, {"rate_hz": round(rate, 1)})
            )

    def _gravity_at(self, t: float) -> Gravity:
        """Return gravity at the phone's place at t (s); a rest may close after later changes of place."""
        return next((move.left for move in self._state.moves if t <= move.t), self._state.gravity)
