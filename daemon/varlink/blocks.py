"""The blocks that Record and Stream send: JSON, made once for all clients, and bounded in size."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import Any

import msgspec
import numpy as np

from stillcal.calib_core.streams.events import Charging, Location
from stillcal.calib_core.streams.samples import Samples
from stillcal.daemon.service.live_stream import Interruption, Live
from stillcal.daemon.service.sample_readers import Recorded
from stillcal.daemon.service.subscribers import BACKLOG
from stillcal.daemon.wire.messages import Hello

RECORD_BLOCKS = 8
"""Blocks of a recording that are kept as JSON for clients who keep up; the largest are some 1 MB."""


def recorded(item: Recorded) -> msgspec.Raw | None:
    """Return samples or an event as JSON of a Block; None for what a recording does not hold."""
    if isinstance(item, Samples):
        return _samples(item)
    if isinstance(item, Hello):
        return _claims(item.claims)
    if isinstance(item, Charging):
        return _json({"t_s": item.t, "charging": item.on})
    if isinstance(item, Location):
        place = [item.latitude, item.longitude, *([] if item.altitude is None else [item.altitude])]
        return _json({"t_s": item.t, "location": place})
    return None


def record_begun(claims: Mapping[str, Any]) -> msgspec.Raw:
    """Return the first block of a recording, with what the phone's maker claims."""
    return _claims(claims)


def record_ended() -> msgspec.Raw:
    """Return the last block of a recording, which is empty."""
    return _json({})


@functools.lru_cache(maxsize=RECORD_BLOCKS)
def _samples(samples: Samples) -> msgspec.Raw:
    """Return samples as JSON of a Block, made once for all clients."""
    content: dict[str, Any] = {
        "sensor": samples.sensor.value,
        "samples": np.column_stack((samples.t, samples.xyz)).tolist(),
    }
    if samples.temperature is not None and bool(np.isfinite(samples.temperature).all()):
        content["temperature_c"] = samples.temperature.tolist()
    return _json(content)


def _claims(claims: Mapping[str, Any]) -> msgspec.Raw:
    return _json({"claims": msgspec.json.encode(claims).decode()})


def _json(content: Mapping[str, Any]) -> msgspec.Raw:
    return msgspec.Raw(msgspec.json.encode(content))


@functools.lru_cache(maxsize=BACKLOG)
def live(item: Live) -> msgspec.Raw:
    """Return a piece of the live stream as JSON of a StreamBlock, made once for all clients."""
    if isinstance(item, Interruption):
        return _notice(item.reason)
    samples = item.samples
    content = {
        "sensor": samples.sensor.value,
        "calibrated": item.calibrated,
        "host_s": item.host_s,
        "samples": np.column_stack((samples.t, samples.xyz)).tolist(),
    }
    return _json(content)


def stream_begun() -> msgspec.Raw:
    """Return the first piece of a live stream."""
    return _notice("begun")


def stream_ended() -> msgspec.Raw:
    """Return the last piece of a live stream."""
    return _notice("the daemon is stopping")


def _notice(text: str) -> msgspec.Raw:
    return _json({"notice": text})
