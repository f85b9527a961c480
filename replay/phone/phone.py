"""A phone: its sensors, clock, heat, effects and what its maker claims; read from TOML and written back."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import msgspec

from stillcal.calib_core.streams.samples import Sensor
from stillcal.replay.formats import claims as formats
from stillcal.replay.phone.effects.on_settings import TiltCreep
from stillcal.replay.phone.effects.registry import AnyEffect
from stillcal.replay.phone.scenario import read_settings
from stillcal.replay.phone.settings import ClockSettings, HeatSettings, SensorSettings, Settings, per_axis


class Claims(formats.Claims, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The maker's claims about the phone, right or wrong; unknown fields in a phone file are refused."""


class Phone(Settings, frozen=True, kw_only=True, rename={"effects": "effect"}):
    """A simulated phone: all its departures from true motion. gyro: None for a phone without one."""

    description: str = ""
    accel: SensorSettings = SensorSettings()
    gyro: SensorSettings | None = SensorSettings()
    clock: ClockSettings = ClockSettings()
    heat: HeatSettings = HeatSettings()
    claims: Claims = Claims()
    effects: tuple[AnyEffect, ...] = ()

    def sensor(self, which: Sensor) -> SensorSettings | None:
        """Return a sensor's settings with all effects on settings in them."""
        settings = self.accel if which is Sensor.ACCELEROMETER else self.gyro
        if settings is None:
            return None
        for effect in self.effects:
            settings = effect.on_sensor(settings) if effect.concerns(which) else settings
        return settings

    def effective_clock(self) -> ClockSettings:
        """Return the clock's settings with all effects on it in them."""
        clock = self.clock
        for effect in self.effects:
            clock = effect.on_clock(clock)
        return clock

    def creep(self) -> TiltCreep | None:
        """Return the creep of what the phone lies on, None where it is firm."""
        return next((e for e in self.effects if isinstance(e, TiltCreep)), None)

    def claimed(self) -> dict[str, Any]:
        """Return the maker's claims as `NAME.json` has them; claims not given come from the settings."""
        claims: dict[str, Any] = {"device": self.description, "nominal_rate_hz": self.accel.rate_hz}
        for name, settings in (("accel", self.accel), ("gyro", self.gyro)):
            if settings is not None:
                claims[f"{name}_range"] = settings.range
                claims[f"{name}_lsb"] = settings.lsb or None
                claims[f"{name}_noise_density"] = float(per_axis(settings.noise.white).max()) or None
        claims |= msgspec.to_builtins(self.claims)
        return {key: value for key, value in claims.items() if value is not None}


def load_phone(name: str | Path) -> Phone:
    """Load a phone by path or by the name of a ready one. Raises ValueError saying what is wrong where."""
    return read_settings(name, "phones", Phone)


def dump_phone(phone: Phone) -> str:
    """Return the phone as the text of a TOML file that `load_phone` reads back to an equal phone."""
    return toml_text(msgspec.to_builtins(phone))


def toml_text(table: dict[str, Any]) -> str:
    """Return a nested dict of numbers, texts, lists and dicts as TOML."""
    lines: list[str] = []
    _write_table(table, "", lines)
    return "\n".join(lines) + "\n"


def _is_rows(value: Any) -> bool:
    return isinstance(value, list | tuple) and bool(value) and all(isinstance(v, dict) for v in value)


def _write_table(table: dict[str, Any], prefix: str, lines: list[str]) -> None:
    nested = {k: v for k, v in table.items() if isinstance(v, dict) or _is_rows(v)}
    lines += [f"{key} = {_literal(v)}" for key, v in table.items() if key not in nested and v is not None]
    for key, value in nested.items():
        for row in [value] if isinstance(value, dict) else value:
            opening = f"[{prefix}{key}]" if isinstance(value, dict) else f"[[{prefix}{key}]]"
            lines += ["", opening]
            _write_table(row, f"{prefix}{key}.", lines)


def _literal(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return msgspec.json.encode(value).decode()
    if isinstance(value, list | tuple):
        return f"[{', '.join(_literal(v) for v in value)}]"
    if isinstance(value, float) and math.isinf(value):
        return "inf" if value > 0 else "-inf"
    return repr(value)
