"""Gazebo's SDF, corrected: mean, stddev and dynamic bias of one <imu>, and its sensor's update_rate.

What the elements mean is said, with sources, in `stillcal.replay.export.targets.gazebo`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stillcal.calib_core.diagnosis.comparison.noise.white_noise import OF_DENSITY
from stillcal.calib_core.errors import UserError
from stillcal.replay.export.fix.findings import (
    AXES,
    SLOW_NOISE,
    WHITE,
    CannotHold,
    Finding,
    Fixed,
    apply_findings,
    changed_axes,
    level,
    note_change,
    on_its_axes,
    ratio,
    recorded,
    rounded,
    slow_deviation,
    to_add,
)
from stillcal.replay.export.fix.xml_text import Node, parsed, text_at, with_child, with_text
from stillcal.replay.export.imu import gauss_markov_allan
from stillcal.replay.export.targets.gazebo import LONG_S

ELEMENTS = {"accel": "linear_acceleration", "gyro": "angular_velocity"}

EMPTY = """<?xml version='1.0'?>
<sdf version='1.7'>
  <model name='imu'>
    <link name='link'>
      <sensor name='imu' type='imu'>
        <always_on>1</always_on>
        <imu>
        </imu>
      </sensor>
    </link>
  </model>
</sdf>
"""


class Gazebo:
    """One correction of one file."""

    def __init__(self, text: str) -> None:
        self._data = text.encode()
        self._fixed = Fixed(text)
        found = len(parsed(self._data).all("imu"))
        if found != 1:
            raise UserError(f"holds {found} <imu> elements: expected one")

    def fix(self, findings: Sequence[Finding]) -> Fixed:
        """Return the file with the differences in it."""
        handlers = {
            "sample_rate": self._rate,
            "accel_bias": self._bias,
            "gyro_bias": self._bias,
            **dict.fromkeys(OF_DENSITY, self._white),
            **dict.fromkeys(SLOW_NOISE, self._slow),
        }
        apply_findings(findings, handlers, self._fixed)
        self._fixed.text = self._data.decode()
        return self._fixed

    def _imu(self) -> Node:
        return parsed(self._data).all("imu")[0]

    def _update_rate(self) -> float | None:
        sensor = self._imu().parent
        node = None if sensor is None else sensor.child("update_rate")
        return None if node is None else _number(text_at(self._data, node), "update_rate")

    def _rate(self, finding: Finding) -> None:
        before, factor = self._update_rate(), float(ratio(finding, "rate"))
        after = float(recorded(finding, "rate")) if before is None else before * factor
        sensor = self._imu().parent
        assert sensor is not None, "an imu stands in a sensor"
        text = repr(float(f"{after:.6g}"))
        node = sensor.child("update_rate")
        if node is None:
            self._data = with_child(self._data, sensor, "update_rate", text)
        else:
            self._data = with_text(self._data, node, text)
        note_change(self._fixed, "update_rate, Hz", np.nan if before is None else before, after)
        for element in ELEMENTS.values():
            for axis in range(3):
                if old := self._value(element, axis, "stddev"):
                    self._set(element, axis, "stddev", old * float(np.sqrt(factor)))

    def _bias(self, finding: Finding) -> None:
        element = ELEMENTS[finding["sensor"]]
        before = np.array([self._value(element, axis, "mean") for axis in range(3)])
        delta = to_add(finding, "bias", before)
        for axis in changed_axes(delta):
            self._set(element, axis, "mean", float(before[axis] + delta[axis]))

    def _white(self, finding: Finding) -> None:
        element = ELEMENTS[finding["sensor"]]
        rate = self._update_rate()
        before = np.array([self._value(element, axis, "stddev") for axis in range(3)])
        if rate is None and (finding["relation"] == "lacking" or not before.all()):
            raise CannotHold("its sensor has no update_rate, on which stddev depends")
        own = recorded(finding, WHITE) * np.sqrt((rate or 0.0) / 2.0)
        after = level(before, finding, WHITE, own)
        for axis in changed_axes(after - before):
            self._set(element, axis, "stddev", float(after[axis]))

    def _slow(self, finding: Finding) -> None:
        element = ELEMENTS[finding["sensor"]]
        names = "dynamic_bias_stddev", "dynamic_bias_correlation_time"
        before, known = (np.array([self._value(element, a, name) for a in range(3)]) for name in names)
        tau = np.where(known == 0.0, LONG_S, known)
        spread = slow_deviation(finding) / np.sqrt(gauss_markov_allan(tau))
        after = on_its_axes(finding, spread * np.sqrt(2.0 / tau), before)
        for axis in changed_axes(after - before):
            self._set(element, axis, "dynamic_bias_stddev", float(after[axis]))
            if known[axis] == 0.0:
                self._set(element, axis, "dynamic_bias_correlation_time", LONG_S)

    def _value(self, element: str, axis: int, name: str) -> float:
        node: Node | None = self._imu()
        for tag in (element, AXES[axis], "noise", name):
            node = None if node is None else node.child(tag)
        return 0.0 if node is None else _number(text_at(self._data, node), f"{element}/{AXES[axis]}/{name}")

    def _set(self, element: str, axis: int, name: str, value: float) -> None:
        before = self._value(element, axis, name)
        node = self._noise(element, axis)
        if node.attributes.get("type", "none") == "none":
            self._gaussian(node)
            node = self._noise(element, axis)
        node = self._descend(node, name)
        self._data = with_text(self._data, node, repr(float(rounded(np.array(value)))))
        note_change(self._fixed, f"{element}/{AXES[axis]}/noise/{name}", before, value)

    def _noise(self, element: str, axis: int) -> Node:
        node = self._imu()
        for tag in (element, AXES[axis], "noise"):
            node = self._descend(node, tag)
        return node

    def _descend(self, node: Node, tag: str) -> Node:
        """Return a child, made where it is missing."""
        if (found := node.child(tag)) is not None:
            return found
        path = _path(node)
        self._data = with_child(
            self._data, node, tag, attributes=" type='gaussian'" if tag == "noise" else ""
        )
        made = _at(parsed(self._data), path).child(tag)
        assert made is not None, "it was made"
        return made

    def _gaussian(self, node: Node) -> None:
        head = self._data[node.start : node.inner].decode()
        kept = [f" {k}='{v}'" for k, v in node.attributes.items() if k != "type"]
        fresh = f"<noise type='gaussian'{''.join(kept)}{'/>' if head.endswith('/>') else '>'}"
        self._data = self._data[: node.start] + fresh.encode() + self._data[node.inner :]


def _path(node: Node) -> list[int]:
    """Return how to come to a node from the root, by the places among the children."""
    out: list[int] = []
    while node.parent is not None:
        out.append(next(i for i, c in enumerate(node.parent.children) if c is node))
        node = node.parent
    return out[::-1]


def _at(root: Node, path: Sequence[int]) -> Node:
    for i in path:
        root = root.children[i]
    return root


def _number(text: str, what: str) -> float:
    try:
        return float(text)
    except ValueError as error:
        raise UserError(f"{what}: {text.strip()[:40]!r} is not a number") from error


def fix(text: str | None, findings: Sequence[Finding]) -> Fixed:
    """Return an SDF file with the differences in it; a new one with one sensor where there is none."""
    return Gazebo(EMPTY if text is None else text).fix(findings)
