"""Files of the daemon's own, and those that an operator gives: settings, phones, other tools' files."""

from __future__ import annotations

import contextlib
import functools
import hashlib
import tempfile
from dataclasses import replace
from pathlib import Path

from stillcal.calib_core.calibration.adoption import adopt
from stillcal.calib_core.calibration.record import CalibrationRecord
from stillcal.calib_core.engine.engine import Engine
from stillcal.calib_core.engine.state import EngineState
from stillcal.calib_core.errors import UserError
from stillcal.daemon.cli.store import _findings
from stillcal.daemon.service import saved_state
from stillcal.daemon.settings import SettingsError, parse_settings
from stillcal.daemon.store.document import StoreDocument, StoreFormatError, parse, render
from stillcal.replay.export.fix.fixers import FIXERS, fixed_for
from stillcal.replay.export.imu import of_record
from stillcal.replay.export.stored import record_of
from stillcal.replay.export.target import text_of
from stillcal.replay.export.targets import INVERTIBLE, target_named
from stillcal.replay.formats.columns import builtin_formats, parse_map
from stillcal.replay.phone.phone import dump_phone, load_phone
from stillcal.replay.phone.scenario import load_scenario
from tests.fuzz.protocols import example_record
from tests.fuzz.target import Target, any_of
from tests.replay.export.test_fix import ALL, PHONE, SDF


def _store_seeds() -> list[bytes]:
    return [render(StoreDocument()), render(StoreDocument(current=example_record()[0]))]


def _feed_store(data: bytes) -> None:
    for trusted in (False, True):
        with contextlib.suppress(StoreFormatError):
            document, _ = parse(data, trusted)
            render(document)


def _state_seeds() -> list[bytes]:
    record, rests = example_record()
    engine = Engine(state=EngineState(record=record))
    engine.add_rests(rests)
    states = [saved_state.SavedState(state) for state in (EngineState(), engine.state)]
    return [saved_state.encode(state)[len(saved_state.HEAD) + 32 :] for state in states]


def _feed_state(data: bytes) -> None:
    """Feed a body under a checksum that is right, which damage by chance never is."""
    whole = saved_state.HEAD + hashlib.sha256(data).digest() + data
    with contextlib.suppress(saved_state.StateError):
        saved_state.decode(whole)


def _settings_seeds() -> list[bytes]:
    lines = ["[engine.schedule]", "check_interval_s = 60", "[store]", "mode = 0o640", '[source]\nport = "x"']
    return ["\n".join(lines).encode(), b"[socket]\nstall_s = 1e3\n[log]\nlevel = 'info'"]


def _feed_settings(data: bytes) -> None:
    with contextlib.suppress(SettingsError, UnicodeDecodeError):
        parse_settings(data.decode("utf-8"))


def _diagnosis_seeds() -> list[bytes]:
    slope = b'{"slope": {"value": [0.011, 0, -0.008], "ci95": [[0.01, 0.012], [0, 0], [-0.009, -0.007]]}}'
    bends = (
        b'{"effect": "accel_bias_temperature", "sensor": "accel", "axes": ["x"], "where": {}, "parameters": '
    )
    matrix = b'{"matrix": {"value": [[0, 1e-4, 0], [0, 0, 0], [0, 0, 0]], "unit": "(rad/s)/(m/s^2)"}}'
    leans = b'{"effect": "gyro_g_sensitivity", "sensor": "gyro", "axes": ["x"], "parameters": '
    found = bends + slope + b', "reference": {"temperature_c": 25}}, ' + leans + matrix + b"}"
    return [b'{"findings": [' + found + b"]}"]


@functools.cache
def _warm_record() -> CalibrationRecord:
    """Return a calibration whose rests have temperatures."""
    record, _ = example_record()
    return replace(record, states=[replace(state, temperature=25.0) for state in record.states])


def _feed_diagnosis(data: bytes) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "day.json"
        path.write_bytes(data)
        refused = (ValueError, KeyError, TypeError, AttributeError)  # adopt-terms makes one line of these
        with contextlib.suppress(*refused):
            render(StoreDocument(current=adopt(_warm_record(), *_findings(path))[0]))


def _map_seeds() -> list[bytes]:
    formats = Path(__file__).parents[2] / "config" / "formats"
    assert {path.stem for path in formats.glob("*.toml")} == set(builtin_formats())
    return [path.read_bytes() for path in sorted(formats.glob("*.toml"))]


def _feed_map(data: bytes) -> None:
    with contextlib.suppress(UserError):
        parse_map(data, Path("map.toml"))


def _phone_seeds() -> list[bytes]:
    return [dump_phone(load_phone("typical")).encode()]


def _scenario_seeds() -> list[bytes]:
    return [(Path(__file__).parents[2] / "config" / "scenarios" / "lab.toml").read_bytes()]


def _feed_described(load: object, data: bytes) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "described.toml"
        path.write_bytes(data)
        with contextlib.suppress(ValueError):
            load(path)  # type: ignore[operator]


def _tool_seeds(tool: str) -> list[bytes]:
    return [target_named(tool).write(of_record(example_record()[0], load_phone("typical")), ["a remark"])]


def _feed_tool(tool: str, data: bytes) -> None:
    with contextlib.suppress(ValueError):  # a UserError is one; `store import` names the file in it
        record = record_of(target_named(tool).read(data), None, "file")
        render(StoreDocument(current=record))


def _simulation_seeds(tool: str) -> list[bytes]:
    texts = {"phone": [PHONE], "gazebo": [SDF]}.get(tool, [])
    return [text.encode() for text in [*texts, fixed_for(tool, None, {"findings": ALL}).text]]


def _feed_simulation(tool: str, data: bytes) -> None:
    """Correct a simulation's configuration; what comes of it must be one of the same tool."""
    with contextlib.suppress(UserError):
        text = text_of(data)
        fixed_for(tool, text, {"findings": []})
        fixed = fixed_for(tool, text, {"findings": ALL})
        try:
            fixed_for(tool, fixed.text, {"findings": []})
        except UserError as error:
            raise AssertionError(f"{tool} no longer reads what was written: {error}") from error


TARGETS = {
    "store": Target(_store_seeds, _feed_store),
    "state": Target(_state_seeds, _feed_state),
    "settings": Target(_settings_seeds, _feed_settings),
    "diagnosis": Target(_diagnosis_seeds, _feed_diagnosis),
    "column-map": Target(_map_seeds, _feed_map),
    "phone": Target(_phone_seeds, functools.partial(_feed_described, load_phone)),
    "scenario": Target(_scenario_seeds, functools.partial(_feed_described, load_scenario)),
    **{
        f"import-{tool}": Target(functools.partial(_tool_seeds, tool), functools.partial(_feed_tool, tool))
        for tool in INVERTIBLE
    },
    "fix-for": any_of(
        [
            Target(functools.partial(_simulation_seeds, tool), functools.partial(_feed_simulation, tool))
            for tool in FIXERS
        ]
    ),
}
