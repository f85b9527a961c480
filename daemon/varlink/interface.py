"""The varlink interface io.stillcal.Calibration: the methods of the socket.

asyncvarlink makes the interface's description from these signatures and docstrings as they are evaluated:
no `from __future__ import annotations` here. connection.py reads and writes the bytes.
"""

# ruff: noqa: N802 - varlink's rules spell methods in CamelCase

from collections.abc import AsyncIterator, Awaitable, Callable
from contextvars import ContextVar
from typing import Any, Protocol

import msgspec
import numpy as np
from asyncvarlink import (
    LastResult,
    TypedVarlinkErrorReply,
    VarlinkInterface,
    varlinkmethod,
    varlinksignature,
)
from asyncvarlink.conversion import ObjectVarlinkType, SimpleVarlinkType, VarlinkType
from asyncvarlink.serviceinterface import InvalidParameter, PermissionDenied

from stillcal.calib_core.calibration.record import CalibrationRecord, NotCalibratedError
from stillcal.calib_core.streams import limits
from stillcal.calib_core.streams.samples import Sensor
from stillcal.calib_core.streams.smoothing import RollingMean
from stillcal.daemon.varlink import blocks, views
from stillcal.daemon.varlink import types as api
from stillcal.daemon.varlink.address import NAME as INTERFACE
from stillcal.daemon.varlink.daemon import Daemon
from stillcal.daemon.varlink.rows import Encoded, Number, Rows

DEFAULT_BATCH_S = 0.02
"""How long the samples of Stream gather unless the caller says otherwise, s."""

MAX_ENTRIES = 400
"""Most entries of one answer: more than the history or the energy ledger usually hold."""


class Caller(Protocol):
    """The client that calls a method. rolling_means: of each sensor whose samples it has smoothed."""

    rolling_means: dict[str, RollingMean]

    @property
    def may_change(self) -> bool:
        """Whether the caller may change the daemon's state."""

    def on_disconnect(self, subscriber: object) -> None:
        """Close `subscriber` when the caller has gone."""


CALLER: ContextVar[Caller] = ContextVar("CALLER")
"""Set by the connection for the time of a call."""


class NotCalibrated(TypedVarlinkErrorReply, interface=INTERFACE):
    """There is no calibration yet. reason: why not; missing: what is needed, such as an attitude."""

    class Parameters:
        """Details of the error."""

        reason: str
        missing: list[str]


class Refused(TypedVarlinkErrorReply, interface=INTERFACE):
    """The request cannot be carried out; reason says why."""

    class Parameters:
        """Details of the error."""

        reason: str


class TooSlow(TypedVarlinkErrorReply, interface=INTERFACE):
    """The caller read its events too slowly; the subscription has ended."""

    class Parameters:
        """The error has no details."""


class CalibrationInterface(VarlinkInterface, name=INTERFACE):
    """Calibration of a phone's accelerometer and gyroscope, maintained by the stillcal daemon.

    SI units: m/s^2, rad/s, s, degrees Celsius. Body axes as on Android. Times are the sensors' own.
    """

    errors = (NotCalibrated, Refused, TooSlow)

    def __init__(self, daemon: Daemon) -> None:
        self._daemon = daemon

    @varlinkmethod(return_parameter="calibration")
    def GetCalibration(self, *, temperature_c: float | None = None) -> api.Calibration:
        """Return the current calibration, its age and whether later checks confirmed it.

        temperature_c: of the sensor now, for which bias_now and bias_uncertainty_now are returned. Where it
        is not told, it is the thermometer's latest reading.
        """
        celsius, record = _possible(temperature_c), self._daemon.view.record
        if record is None:
            refusal = self._daemon.view.refusal
            reason = refusal.reason if refusal else "too few rests so far"
            raise NotCalibrated(reason=reason, missing=list(refusal.missing) if refusal else [])
        return views.calibration(record, self._daemon, celsius)

    @varlinkmethod(return_parameter="status")
    def GetStatus(self) -> api.Status:
        """Return the status of the daemon, the phone and its line."""
        return views.status(self._daemon)

    @varlinkmethod(return_parameter="entries")
    def GetHistory(self, *, limit: int = 32) -> list[api.Entry]:
        """Return the current and at most `limit` earlier or rejected calibrations, newest first."""
        return views.history(self._daemon.document, _within("limit", limit))

    @varlinkmethod(return_parameter="stillness")
    def GetStillness(self, *, limit: int = 96) -> api.Stillness:
        """Return the newest `limit` rests, newest first, and how many windows were stationary."""
        return views.stillness(self._daemon, _within("limit", limit))

    @varlinkmethod(return_parameter="days")
    def GetEnergy(self, *, limit: int = 31) -> list[api.EnergyDay]:
        """Return the energy use of the newest `limit` days, oldest first."""
        return views.energy(self._daemon.saved.energy.days, _within("limit", limit))

    @varlinkmethod(return_parameter="diagnosis")
    def GetFindings(self) -> api.Findings:
        """Return what the newest self-diagnosis found in the rests kept, and what became of each finding."""
        return views.findings(self._daemon)

    @varlinkmethod
    def Correct(
        self,
        *,
        sensor: api.SensorName,
        samples: list[list[float]],
        temperature_c: float | None = None,
        force: list[list[float]] | None = None,
        smooth_hz: float | None = None,
    ) -> api.Corrected:
        """Correct at most 1000 raw samples [x, y, z] of a sensor by the current calibration.

        temperature_c: of the sensor; force: corrected accelerometer [x, y, z] for each
        gyroscope sample. Terms that depend on what is not given are left out. smooth_hz: the sampling
        rate; also remove noise by a rolling mean of 3 to 20 samples, which goes on from this client's
        last call for the sensor. delay_s: how late the samples come because of it.
        """
        raw, celsius = np.array(samples, dtype=np.float64).reshape(-1, 3), _possible(temperature_c)
        mean = None if smooth_hz is None else _rolling_mean(sensor, smooth_hz)
        if self._daemon.view.record is None:
            raise NotCalibrated(reason="no calibration yet", missing=[])
        try:
            with np.errstate(over="ignore", invalid="ignore"):  # refused below
                corrected = views.corrected(self._daemon, Sensor(sensor), raw, celsius, force)
        except NotCalibratedError as error:
            raise NotCalibrated(reason=str(error), missing=[sensor]) from None
        except ValueError:
            raise InvalidParameter(parameter="force") from None
        if not np.isfinite(corrected).all():
            raise InvalidParameter(parameter="samples")
        if mean is None:
            return {"samples": corrected.tolist(), "delay_s": None}
        return {"samples": mean.smoothed(corrected).tolist(), "delay_s": mean.delay_s}

    @varlinkmethod(return_parameter="event", delay_generator=False)
    async def Monitor(self) -> AsyncIterator[api.Event]:
        """Send the present state and then every change. Call it with `more`."""
        subscriber, unsubscribe = self._daemon.subscribers.subscribe()
        CALLER.get().on_disconnect(subscriber)
        try:
            yield views.standing(self._daemon)
            while (notification := await subscriber.queue.get()) is not None:
                yield views.event(notification, self._daemon)
        finally:
            unsubscribe()
        if subscriber.overflowed:
            raise TooSlow()
        raise LastResult(api.Event("ended", "the daemon is stopping"))

    @varlinkmethod(return_parameter="block", return_type=api.Block, delay_generator=False)
    async def Record(self, *, sparing: bool = False) -> AsyncIterator[msgspec.Raw]:
        """Send raw samples and events as they come. Call it with `more`.

        The phone's sensors stay on meanwhile, unless `sparing`: then only what the daemon measures for itself
        is sent. Only for root and the daemon's own user.
        """
        _require_right()
        with self._daemon.readers.recording(sparing) as subscriber:
            CALLER.get().on_disconnect(subscriber)
            yield blocks.record_begun(self._daemon.claims)
            while (item := await subscriber.queue.get()) is not None:
                if (block := blocks.recorded(item)) is not None:
                    yield block
        if subscriber.overflowed:
            raise TooSlow()
        raise LastResult(blocks.record_ended())

    @varlinkmethod(return_parameter="block", return_type=api.StreamBlock, delay_generator=False)
    async def Stream(
        self, *, batch_s: float = DEFAULT_BATCH_S, sparing: bool = False
    ) -> AsyncIterator[msgspec.Raw]:
        """Send corrected samples as they come. Call it with `more`.

        batch_s: how long samples may gather before they are sent, 0..1 s; 0 sends each as soon as it is read.
        Another caller's wish may bring them sooner. The phone's sensors stay on meanwhile, unless `sparing`.
        A caller that does not read is dropped (TooSlow).
        """
        if not 0.0 <= batch_s <= 1.0:
            raise InvalidParameter(parameter="batch_s")
        with self._daemon.readers.streaming(sparing, batch_s) as subscriber:
            CALLER.get().on_disconnect(subscriber)
            yield blocks.stream_begun()
            while (item := await subscriber.queue.get()) is not None:
                yield blocks.live(item)
        if subscriber.overflowed:
            raise TooSlow()
        raise LastResult(blocks.stream_ended())

    @varlinkmethod(return_parameter="calibration")
    async def Rollback(self, *, to: str = "") -> api.Calibration:
        """Make an earlier calibration current: the previous one, or the one whose id begins with `to`.

        Only for root and the daemon's own user.
        """
        return await self._changed(lambda: self._daemon.rollback(to or 1))

    @varlinkmethod(return_parameter="calibration")
    async def Calibrate(self) -> api.Calibration:
        """Try a full calibration now, from the rests held. Only for root and the daemon's own user.

        Refused with the reason where the rests do not support one, or it is no better than the current one.
        """
        return await self._changed(self._daemon.calibrate)

    @varlinkmethod(return_parameter="calibration")
    async def ZeroNow(self) -> api.Calibration:
        """Measure the gyroscope's bias now, on the last hour's rests. Only for root and the own user."""
        return await self._changed(self._daemon.zero)

    @varlinkmethod(return_parameter="faces")
    def GetFaces(self) -> api.Faces:
        """Return how far the six faces have come that LayFaces asked for, and how to lay the phone next."""
        return views.faces(self._daemon)

    @varlinkmethod(return_parameter="faces")
    async def LayFaces(self, *, stop: bool = False) -> api.Faces:
        """Have the phone laid on its six faces, with its sensors on meanwhile; what is laid already stays.

        The sixth face brings the calibration. stop: end it instead. Only for root and the daemon's own user.
        """
        _require_right()
        await self._daemon.lay_faces(stop)
        return views.faces(self._daemon)

    async def _changed(self, change: Callable[[], Awaitable[CalibrationRecord | None]]) -> api.Calibration:
        """Carry out a change, if the caller may; return the calibration that is then current."""
        _require_right()
        try:
            record = await change()
        except ValueError as error:
            raise Refused(reason=str(error)) from None
        if record is None:
            raise NotCalibrated(reason="no calibration is current", missing=[])
        return views.calibration(record, self._daemon)

    @varlinkmethod
    async def Reload(self) -> None:
        """Read the settings again. Only for root and the daemon's own user."""
        _require_right()
        if reason := await self._daemon.reload():
            raise Refused(reason=reason)


def _with_quick_tables() -> None:
    """Have tables and long answers converted at once (rows.py); the description stays as it is."""
    tables: list[tuple[Any, str, Any]] = [
        (CalibrationInterface.Stream, "block", api.StreamBlock),
        (CalibrationInterface.Record, "block", api.Block),
        (CalibrationInterface.GetHistory, "entries", list[api.Entry]),
        (CalibrationInterface.GetStillness, "stillness", api.Stillness),
        (CalibrationInterface.GetEnergy, "days", list[api.EnergyDay]),
    ]
    for method, name, kind in tables:
        answer = varlinksignature(method)
        assert answer is not None
        answer.return_type = ObjectVarlinkType({name: Encoded(kind)})
    signature = varlinksignature(CalibrationInterface.Correct)
    assert signature is not None
    optional_number = VarlinkType.from_type_annotation(float).optional()
    sensor = VarlinkType.from_type_annotation(api.SensorName)
    left_out = {"temperature_c", "force", "smooth_hz"}
    parameters = {"sensor": sensor, "samples": Rows(), "temperature_c": optional_number}
    parameters |= {"force": Rows().optional(), "smooth_hz": optional_number}
    signature.parameter_type = ObjectVarlinkType(parameters, discardnone=left_out)
    corrected = {"samples": Rows(), "delay_s": optional_number}
    signature.return_type = ObjectVarlinkType(corrected, discardnone={"delay_s"})


_with_quick_tables()


def _with_strict_numbers() -> None:
    """Have true and false refused where a method takes a number."""
    for method in vars(CalibrationInterface).values():
        if (signature := varlinksignature(method)) is not None:
            for kind in signature.parameter_type.traverse():
                if isinstance(kind, SimpleVarlinkType) and kind.as_type in (int, float):
                    kind.__class__ = Number


_with_strict_numbers()


def _rolling_mean(sensor: str, rate_hz: float) -> RollingMean:
    """Return the client's rolling mean of a sensor; it begins anew with another rate."""
    means = CALLER.get().rolling_means
    if sensor not in means or means[sensor].rate_hz != rate_hz:
        try:
            means[sensor] = RollingMean(rate_hz)
        except ValueError:
            raise InvalidParameter(parameter="smooth_hz") from None
    return means[sensor]


def _require_right() -> None:
    if not CALLER.get().may_change:
        raise PermissionDenied()


def _possible(temperature_c: float | None) -> float | None:
    """Return a temperature, degC, that was told, None where none was; refuse one that no sensor can have."""
    if temperature_c is not None and not limits.within("celsius", temperature_c):
        raise InvalidParameter(parameter="temperature_c")
    return temperature_c


def _within(name: str, value: int | None) -> int:
    number = 32 if value is None else value
    if not 0 <= number <= MAX_ENTRIES:
        raise InvalidParameter(parameter=name)
    return number
