"""The page of the Python API, from docstrings: the public interface, then the core's modules.

`python -m stillcal.replay.trials.pages.core_api > docs/api.md` writes it.
"""

from __future__ import annotations

import dataclasses
import enum
import importlib
import inspect
import textwrap
from collections.abc import Iterator
from types import ModuleType
from typing import Any

import click

from stillcal import api

WIDTH = 100

HEAD = """\
# Python API

*For people who write Python with stillcal.*

The public interface is `stillcal` itself: `load`, `calibrate`, `apply`, `diagnose`, `simulate`, and what they
return. The modules of the core after it are internal: they may change without notice. This page is made
from the docstrings by `python -m stillcal.replay.trials.pages.core_api > docs/api.md`; a test compares the
two, and the example below is run as a test.

```python
import stillcal

recording = stillcal.load("sample:lab")            # or "walk.csv", a data frame, arrays
calibration = stillcal.calibrate(recording)
print(calibration.accelerometer.bias)              # m/s^2
print(calibration.accelerometer.bias_interval)     # 95 %, (2, 3)
calibrated = stillcal.apply(recording, calibration)
calibrated.save("lab-calibrated.csv")
diagnosis = stillcal.diagnose(recording)
print(diagnosis.verdict, [f["effect"] for f in diagnosis.findings])
simulated = stillcal.simulate("lab", phone="mpu6050", seed=1)
```

In a notebook, recordings, calibrations and diagnoses show themselves as tables.

Navigation, steps, coning and motion modes are methods that only the studies of the papers use: where they are
and an example is in [evaluation.md](evaluation.md#where-the-papers-methods-are).
"""

INTERNAL = """\
# Internal: the core's modules

`stillcal.calib_core` is pure: arrays in, values out; no file, clock, socket or log. It is documented for
those who change it or read how a number comes about; other programs should use the public interface above.
SI units throughout, body axes as on Android (x right, y up, z out of the screen); `Array` is a numpy array of
float64, read-only where it is kept.
"""

PUBLIC = (
    "load",
    "calibrate",
    "apply",
    "diagnose",
    "simulate",
    "Recording",
    "Calibration",
    "Diagnosis",
    "UserError",
    "NotSupported",
)
"""The public interface in the order of use."""

MODULES = (
    "streams.samples",
    "streams.events",
    "static.detector",
    "static.settings",
    "static.rest",
    "gyroscope.rotation_segment",
    "gravity",
    "model",
    "accelerometer.fit",
    "accelerometer.observability",
    "accelerometer.prior",
    "gyroscope.fit",
    "gyroscope.bias",
    "noise.covariance",
    "noise.allan",
    "maths.rotation",
    "errors",
    "engine.engine",
    "engine.actions",
)
"""Those that users call, from what is measured to what decides."""


def page() -> str:
    """Return the page in Markdown."""
    public = "\n".join(part for name in PUBLIC for part in _entry(name, getattr(api, name)))
    modules = {name: importlib.import_module(f"stillcal.calib_core.{name}") for name in MODULES}
    rows = "\n".join(
        f"| [`{name}`](#{_anchor(name)}) | {_first(module)} |" for name, module in modules.items()
    )
    parts = [part for name, module in modules.items() for part in _module(name, module)]
    table = f"{INTERNAL}\n| module | |\n|---|---|\n{rows}\n"
    return "\n".join([HEAD, f"## stillcal\n\n{_prose(api)}\n", public, table, *parts])


def _anchor(title: str) -> str:
    """Return the link that a heading gets on common hosts: without its dots."""
    return title.replace(".", "")


def _first(module: ModuleType) -> str:
    return " ".join((inspect.getdoc(module) or "").split("\n\n")[0].split())


def _module(title: str, module: ModuleType) -> Iterator[str]:
    yield f"## {title}\n\n{_prose(module)}\n"
    yield from _members(module)


def _members(module: ModuleType) -> Iterator[str]:
    """Yield the functions and classes of a module: those of `__all__`, and its own without underscore."""
    handed_on = getattr(module, "__all__", ())
    for name, value in vars(module).items():
        own = getattr(value, "__module__", None) == module.__name__
        if (own and not name.startswith("_")) or name in handed_on:
            yield from _entry(name, value)


def _entry(name: str, value: Any) -> Iterator[str]:
    if inspect.isfunction(value):
        yield f"### `{name}`\n\n{_call(name, value)}\n"
    elif inspect.isclass(value):
        yield from _class(name, value)


def _class(name: str, value: type) -> Iterator[str]:
    """Yield a class and the methods that it has of its own."""
    yield f"### `{name}`\n\n{_prose(value)}\n"
    fields = [field.name for field in dataclasses.fields(value)] if dataclasses.is_dataclass(value) else []
    fields += getattr(value, "__struct_fields__", ())
    fields = [field for field in fields if not field.startswith("_")]
    if fields:
        yield "Fields: {}.\n".format(", ".join(f"`{field}`" for field in fields))
    if not issubclass(value, enum.Enum):
        for inner, method in vars(value).items():
            function = getattr(method, "__func__", method)
            if not inner.startswith("_") and inspect.isfunction(function):
                yield f"{_call(f'{name}.{inner}', function)}\n"
            elif not inner.startswith("_") and isinstance(method, property):
                yield f"`{name}.{inner}`: {_prose(method)}\n"


class _Word:
    """Shown as it is, without quotes."""

    def __init__(self, text: str) -> None:
        self.text = text

    def __repr__(self) -> str:
        return self.text


def _call(name: str, function: Any) -> str:
    """Return a call as one would write it, without what a method is given by itself, and what it does."""
    signature = inspect.signature(function)
    own = [_readable(p) for p in signature.parameters.values() if p.name not in {"self", "cls"}]
    call = name + str(
        signature.replace(parameters=own, return_annotation=_Word(str(signature.return_annotation)))
    )
    kept = call.replace(": ", ":\0").replace(" = ", "\0=\0")  # a parameter stands on one line
    lines = [line.replace("\0", " ") for line in textwrap.wrap(kept, WIDTH, subsequent_indent="    ")]
    return "```python\n{}\n```\n\n{}".format("\n".join(lines), _prose(function))


def _readable(parameter: inspect.Parameter) -> inspect.Parameter:
    """Return a parameter with its annotation as written, and settings by default said as `...`."""
    long = "(" in repr(parameter.default) and not isinstance(parameter.default, tuple)
    default = _Word("...") if long else parameter.default
    return parameter.replace(annotation=_Word(str(parameter.annotation)), default=default)


def _prose(value: Any) -> str:
    """Return a docstring with its examples fenced."""
    blocks = (inspect.getdoc(value) or "").split("\n\n")
    return "\n\n".join(f"```pycon\n{block}\n```" if block.startswith(">>>") else block for block in blocks)


if __name__ == "__main__":
    click.echo(page())
