"""stillcal's own phone file, corrected: constant errors, noise, rate, and the effects by their names.

It holds every difference but those that belong to one moment of one recording. Where the file is laid out
plainly its comments and order stay; otherwise it is written anew.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Sequence
from typing import Any

import msgspec
import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.calibration.corrections.bias_temperature import POWER_NAMES
from stillcal.calib_core.diagnosis.comparison.direct import ALIKE, LINE
from stillcal.calib_core.diagnosis.comparison.noise.white_noise import OF_DENSITY, of_some_axes
from stillcal.calib_core.diagnosis.effects.warmup import SETTLED
from stillcal.calib_core.diagnosis.slow.wander import WALK
from stillcal.calib_core.errors import UserError
from stillcal.calib_core.noise.allan import FLOOR
from stillcal.replay.export.fix.findings import (
    WHITE,
    CannotHold,
    Finding,
    Fixed,
    NothingToTakeOut,
    apply_findings,
    difference,
    gain_after,
    level,
    note_change,
    on_its_axes,
    powers_of,
    ratio,
    recorded,
    reference_c,
    restated,
    rounded,
    slow_deviation,
    to_add,
)
from stillcal.replay.export.fix.toml_text import edited
from stillcal.replay.export.imu import LAG_S, noise_of
from stillcal.replay.phone.effects.base import Effect
from stillcal.replay.phone.effects.on_settings import FILTERS_ALL
from stillcal.replay.phone.effects.registry import EFFECTS
from stillcal.replay.phone.phone import Phone, dump_phone
from stillcal.replay.phone.settings import Noise, SensorSettings, per_axis

OF_ONE_MOMENT = {
    "accel_bias_step": "it happened at one moment of the recording",
    "gyro_bias_step": "it happened at one moment of the recording",
    "thermal_latent": "its amplitude is that of the recording's own warmth, which a phone file does not have",
}


SETTINGS = {
    "timestamp_jitter": ("clock", "jitter_s", "sigma"),
    "dropped_samples": ("clock", "drop_fraction", "fraction"),
    "accel_gyro_time_offset": ("clock", "gyro_delay_s", "delay"),
    "clock_skew": ("clock", "skew", "relative"),
    "bandwidth": ("", "cutoff_hz", "cutoff"),
}
"""Effects that a phone may have as a setting: its table ("" for the sensor's), its name, its number."""


def _whole(finding: Finding, name: str) -> bool:
    """Whether a parameter is the part of the recording in which an effect is there, and may be all of it."""
    return name == "fraction" and float(np.max(finding["parameters"][name]["ci95"])) >= 1.0


class _Phone:
    """One correction of one phone."""

    def __init__(self, phone: Phone, fixed: Fixed) -> None:
        self.phone = phone
        self._fixed = fixed

    def bias(self, finding: Finding) -> None:
        self._add_bias(finding, to_add(finding, "bias", np.asarray(self._sensor(finding).bias)))

    def bias_temperature(self, finding: Finding) -> None:
        """Put in a polynomial about the phone's own reference; the bias stays as it is at the finding's."""
        own, at = self.phone.heat.reference_c, reference_c(finding)
        about = finding if at is None else restated(finding, own - at)
        added = self._effect(about, {name: difference(about, name) for name in powers_of(about)})
        if at is not None:
            by_power = enumerate(POWER_NAMES, start=1)
            gone = [d * (at - own) ** p for p, name in by_power if (d := added.get(name)) is not None]
            self._add_bias(finding, -sum(gone, np.zeros(3)))

    def scale(self, finding: Finding) -> None:
        self._set_gain(finding, gain_after(finding, np.asarray(self._sensor(finding).scale)))

    def scale_temperature(self, finding: Finding) -> None:
        delta, at = (
            self._effect(finding, {"slope": difference(finding, "slope")})["slope"],
            reference_c(finding),
        )
        if at is not None:
            gained = np.eye(3) + np.diag(delta * (self.phone.heat.reference_c - at))
            self._set_gain(finding, gained @ np.asarray(self._sensor(finding).scale))

    def warmup(self, finding: Finding) -> None:
        """Put in a settling. The phone's bias is that of the start: where the settled one stays, it moves."""
        before = self._own(finding, "amplitude")
        self.other(finding)
        if finding.get("reference", {}).get(SETTLED):
            self._add_bias(finding, before - self._own(finding, "amplitude"))

    def _own(self, finding: Finding, name: str) -> Array:
        """Return a number (3,) of the phone's effect that a finding is of, 0 where it has none."""
        own = [getattr(e, name) for e in self.phone.effects if _is_of(e, finding)]
        return sum(map(np.asarray, own), np.zeros(3))

    def white(self, finding: Finding) -> None:
        noise = self._sensor(finding).noise
        before = per_axis(noise.white)
        after = level(before, finding, WHITE, recorded(finding, WHITE))
        self._set_noise(finding, white=_vector(after))
        note_change(self._fixed, f"{finding['sensor']}.noise.white", before, after)

    def slow(self, finding: Finding) -> None:
        """Multiply all slow noise to have the recording's Allan deviation; flicker where there is none."""
        settings = self._sensor(finding)
        noise, before = settings.noise, noise_of(settings).slow_deviation()
        after = on_its_axes(finding, slow_deviation(finding), before)
        factor = np.divide(after, before, out=np.ones(3), where=before > 0.0)
        flicker = per_axis(noise.flicker) * factor + np.where(before > 0.0, 0.0, after / FLOOR)
        wandering = tuple(
            msgspec.structs.replace(g, sigma=_vector(per_axis(g.sigma) * factor)) for g in noise.gauss_markov
        )
        walk = _vector(per_axis(noise.random_walk) * factor)
        self._set_noise(finding, flicker=_vector(flicker), gauss_markov=wandering, random_walk=walk)
        place = f"{finding['sensor']}.noise: Allan deviation of its slow noise at {LAG_S:g} s"
        note_change(self._fixed, place, before, after)

    def walk(self, finding: Finding) -> None:
        """Give the phone the recording's density: its effect, beside its own walk, or its own walk alone."""
        noise = self._sensor(finding).noise
        before, effect = per_axis(noise.random_walk), self._own(finding, WHITE)
        gone = finding["relation"] == "superfluous"
        wanted = np.zeros(3) if gone else recorded(finding, WHITE)
        if effect.any() and not gone:
            beside = np.sqrt(np.maximum(np.square(wanted) - np.square(before), 0.0))
            self.other({**finding, "difference": {WHITE: {"value": (beside - effect).tolist()}}})
            return
        if effect.any() or not before.any():
            self.other(finding)
            return
        after = on_its_axes(finding, wanted, before)
        self._set_noise(finding, random_walk=_vector(after))
        note_change(self._fixed, f"{finding['sensor']}.noise.random_walk", before, after)

    def rate(self, finding: Finding) -> None:
        factor = float(ratio(finding, "rate"))
        for which in ("accel", "gyro"):
            settings = getattr(self.phone, which)
            if settings is None:
                continue
            after = float(f"{settings.rate_hz * factor:.6g}")
            cutoff = settings.cutoff_hz
            beyond = cutoff is not None and cutoff >= after / 2
            self._set_sensor(which, rate_hz=after, cutoff_hz=None if beyond else cutoff)
            note_change(self._fixed, f"{which}.rate_hz", settings.rate_hz, after)
            if beyond:
                self._fixed.changed.append(
                    f"{which}.cutoff_hz: {cutoff:g} taken out: not below half the rate"
                )

    def setting(self, finding: Finding) -> None:
        """Change what the phone has as a setting of its own; without one, it is an effect like others."""
        table, field, parameter = SETTINGS[finding["effect"]]
        if field == "cutoff_hz" and of_some_axes(finding["axes"]):
            raise CannotHold(FILTERS_ALL)
        owner = table or finding["sensor"]
        settings = getattr(self.phone, owner)
        before = None if settings is None else getattr(settings, field)
        if not before or any(_is_of(e, finding) for e in self.phone.effects):
            self.other(finding)
            return
        if finding["relation"] == "superfluous":
            self._set_sensor(owner, **{field: None if field == "cutoff_hz" else 0.0})
            self._fixed.changed.append(f"{owner}.{field}: {before:g} taken out")
            return
        after = float(rounded(recorded(finding, parameter)))
        self._set_sensor(owner, **{field: after})
        note_change(self._fixed, f"{owner}.{field}", before, after)

    def other(self, finding: Finding) -> None:
        """Put in an effect that the phone lacks, change one that it has, or take one out."""
        if finding["effect"] in OF_ONE_MOMENT:
            raise CannotHold(OF_ONE_MOMENT[finding["effect"]])
        kind = EFFECTS.get(finding["effect"])
        if kind is None:
            raise CannotHold("a phone file has no effect of this name")
        if not finding["parameters"]:
            self._remove(finding)
            return
        values: dict[str, Any] = {}
        for name, given in {**finding["parameters"], **finding["difference"]}.items():
            if name in kind.__struct_fields__:
                value = np.asarray(given["value"], dtype=np.float64)
                values[name] = difference(finding, name) if value.ndim else float(recorded(finding, name))
        known = {k: v for k, v in finding.get("reference", {}).items() if k in kind.__struct_fields__}
        self._effect(finding, values | known)
        unused = [
            n for n in finding["parameters"] if n not in kind.__struct_fields__ and not _whole(finding, n)
        ]
        if unused:
            raise CannotHold(f"it is put in, but there is no setting for its {' and '.join(unused)}")

    def _effect(self, finding: Finding, values: dict[str, Any]) -> dict[str, Any]:
        """Add vectors to those of the phone's effect of the same name and sensor; set its other numbers.

        Returns what was added to each vector. A superfluous effect is taken out on the axes of the finding.
        """
        name, sensor = finding["effect"], finding["sensor"]
        kind = EFFECTS[name]
        own = {"sensor": sensor} if "sensor" in kind.__struct_fields__ and sensor in ("accel", "gyro") else {}
        for index, effect in enumerate(self.phone.effects):
            if _is_of(effect, finding):
                before = {k: getattr(effect, k) for k in values}
                added = {k: to_add(finding, k, before[k]) for k, v in values.items() if np.ndim(v)}
                after = {k: np.asarray(before[k]) + added[k] if k in added else v for k, v in values.items()}
                kept = [*self.phone.effects[:index], *self.phone.effects[index + 1 :]]
                if added and not any(after[k].any() for k in added):
                    self._set_effects(kept)
                    self._fixed.changed.append(f"{name}: taken out")
                    return added
                made = self._made(kind, {**msgspec.structs.asdict(effect), **after})
                self._set_effects([*kept[:index], made, *kept[index:]])
                for key, value in after.items():
                    note_change(self._fixed, f"{name}.{key}", np.asarray(before[key]), np.asarray(value))
                return added
        if finding["relation"] == "superfluous":
            raise NothingToTakeOut
        made = self._made(kind, {**own, **values})
        self._set_effects([*self.phone.effects, made])
        for key, value in values.items():
            note_change(self._fixed, f"{name}.{key}", 0.0, np.asarray(value))
        return values

    def _made(self, kind: type[Effect], values: dict[str, Any]) -> Any:
        plain = {k: rounded(v).tolist() if isinstance(v, np.ndarray) else v for k, v in values.items()}
        try:
            return msgspec.convert({"name": kind.__struct_config__.tag, **plain}, type=kind)
        except (msgspec.ValidationError, ValueError) as error:
            raise CannotHold(str(error)) from error

    def _remove(self, finding: Finding) -> None:
        kept = [e for e in self.phone.effects if not _is_of(e, finding)]
        if len(kept) == len(self.phone.effects):
            raise CannotHold("the phone has no effect of this name")
        self._set_effects(kept)
        self._fixed.changed.append(f"{finding['effect']}: taken out")

    def _set_effects(self, effects: Sequence[Any]) -> None:
        self.phone = msgspec.structs.replace(self.phone, effects=tuple(effects))

    def _sensor(self, finding: Finding) -> SensorSettings:
        settings = getattr(self.phone, finding["sensor"])
        if settings is None:
            raise CannotHold("the phone has no such sensor")
        assert isinstance(settings, SensorSettings), "accel and gyro are sensors"
        return settings

    def _set_sensor(self, which: str, **values: Any) -> None:
        try:
            settings = msgspec.structs.replace(getattr(self.phone, which), **values)
        except ValueError as error:
            raise CannotHold(str(error)) from error
        self.phone = msgspec.structs.replace(self.phone, **{which: settings})

    def _set_noise(self, finding: Finding, **values: Any) -> None:
        noise: Noise = msgspec.structs.replace(self._sensor(finding).noise, **values)
        self._set_sensor(finding["sensor"], noise=noise)

    def _add_bias(self, finding: Finding, delta: Array) -> None:
        if not delta.any():
            return
        before = np.asarray(self._sensor(finding).bias)
        self._set_sensor(finding["sensor"], bias=_vector(before + delta))
        note_change(self._fixed, f"{finding['sensor']}.bias", before, before + delta)

    def _set_gain(self, finding: Finding, after: Array) -> None:
        before = np.asarray(self._sensor(finding).scale)
        rows = tuple(_vector(row) for row in after)
        self._set_sensor(finding["sensor"], scale=rows)
        note_change(self._fixed, f"{finding['sensor']}.scale", before, after)


def _is_of(effect: Effect, finding: Finding) -> bool:
    """Whether a phone's effect is the finding's: by name, sensor and, of several lines, frequency."""
    if effect.name != finding["effect"]:
        return False
    sensor = finding["sensor"]
    if sensor in ("accel", "gyro") and getattr(effect, "sensor", sensor) != sensor:
        return False
    hertz = getattr(effect, LINE, None)
    if hertz is None:
        return True
    simulated = finding["simulated"].get(LINE, {}).get("value")
    return simulated is not None and abs(float(np.log(hertz / simulated))) <= ALIKE


def _vector(values: Array) -> tuple[float, float, float]:
    x, y, z = rounded(values).tolist()
    return (x, y, z)


def fix(text: str | None, findings: Sequence[Finding]) -> Fixed:
    """Return a phone file with the differences in it; of a phone without errors where there is none."""
    before = Phone() if text is None else phone_from(text)
    fixed = Fixed("")
    work = _Phone(before, fixed)
    handlers: dict[str, Callable[[Finding], None]] = dict.fromkeys(OF_DENSITY, work.white)
    handlers |= {"sample_rate": work.rate, **dict.fromkeys(SETTINGS, work.setting)}
    for sensor in ("accel", "gyro"):
        handlers |= {
            f"{sensor}_bias": work.bias,
            f"{sensor}_bias_temperature": work.bias_temperature,
            f"{sensor}_scale": work.scale,
            f"{sensor}_scale_temperature": work.scale_temperature,
            f"{sensor}_slow_noise": work.slow,
            f"{sensor}{WALK}": work.walk,
            f"{sensor}_warmup": work.warmup,
        }
    apply_findings(findings, handlers, fixed, otherwise=work.other)
    fixed.text = _text(text, before, work.phone, fixed)
    return fixed


def phone_from(text: str) -> Phone:
    """Return the phone of a file's text. Raises UserError where it is none."""
    try:
        return msgspec.convert(tomllib.loads(text), type=Phone)
    except (tomllib.TOMLDecodeError, msgspec.ValidationError, ValueError) as error:
        raise UserError(f"not a phone file: {error}") from error


def _text(text: str | None, before: Phone, after: Phone, fixed: Fixed) -> str:
    """Return the phone's text: the user's own with the values changed, or one written anew."""
    whole = dump_phone(after)
    if text is None:
        return whole
    changed = edited(text, msgspec.to_builtins(before), msgspec.to_builtins(after))
    try:
        if phone_from(changed) == after:
            return changed
    except UserError:
        pass
    fixed.changed.append("the file is written anew: its comments are lost")
    return whole
