"""The core's reference, from its own docstrings.

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

WIDTH = 100

HEAD = """\
# The core, as a library

`stillcal.calib_core` is pure: arrays in, values out; no file, clock, socket or log. Here stand its modules
for users, as they say it themselves: `python -m stillcal.replay.trials.pages.core_api > docs/api.md` makes
this page, a test holds it against them, and the examples are run as tests too. SI units throughout, body axes
as on Android (x right, y up, z out of the screen); `Array` is a numpy array of float64, read-only where it is
kept.

From a recording to a calibration, in Python:

```python
from stillcal.calib_core.accelerometer.fit import fit
from stillcal.calib_core.static.detector import StationaryDetector
from stillcal.calib_core.static.rest import force_uncertainties, forces
from stillcal.replay.formats.trace import read_all

recording = read_all("walk.csv")
detector = StationaryDetector()
rests = detector.feed(recording.gyroscope, recording.accelerometer) + detector.finish()
calibration = fit(forces(rests), force_uncertainties(rests), gravity=9.81)
true = calibration.model.apply(recording.accelerometer.xyz)      # scale @ (raw - bias), (n, 3)
```

The engine that does this live, and the diagnosis (`stillcal.calib_core.diagnosis`, [diagnosis.md](diagnosis.md)),
are best called as the commands do: `stillcal.replay.runner.replay`,
`stillcal.replay.diagnosis.diagnose.diagnosis_of`.
"""

MODULES = (
    "streams.samples",
    "streams.events",
    "static.detector",
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
    modules = {name: importlib.import_module(f"stillcal.calib_core.{name}") for name in MODULES}
    rows = "\n".join(
        f"| [`{name}`](#{_anchor(name)}) | {_first(module)} |" for name, module in modules.items()
    )
    parts = [part for name, module in modules.items() for part in _module(name, module)]
    return "\n".join([HEAD, f"| module | |\n|---|---|\n{rows}\n", *parts])


def _anchor(title: str) -> str:
    """Return the link that a heading gets on common hosts: without its dots."""
    return title.replace(".", "")


def _first(module: ModuleType) -> str:
    return " ".join((inspect.getdoc(module) or "").split("\n\n")[0].split())


def _module(title: str, module: ModuleType) -> Iterator[str]:
    yield f"## {title}\n\n{_prose(module)}\n"
    handed_on = getattr(module, "__all__", ())
    for name, value in vars(module).items():
        own = getattr(value, "__module__", None) == module.__name__
        if (own and not name.startswith("_")) or name in handed_on:
            if inspect.isfunction(value):
                yield f"### `{name}`\n\n{_call(name, value)}\n"
            elif inspect.isclass(value):
                yield from _class(name, value)


def _class(name: str, value: type) -> Iterator[str]:
    """Yield a class and the methods that it has of its own."""
    yield f"### `{name}`\n\n{_prose(value)}\n"
    fields = [field.name for field in dataclasses.fields(value)] if dataclasses.is_dataclass(value) else []
    fields += getattr(value, "__struct_fields__", ())
    if fields:
        yield "Fields: {}.\n".format(", ".join(f"`{field}`" for field in fields))
    if not issubclass(value, enum.Enum):
        for inner, method in vars(value).items():
            function = getattr(method, "__func__", method)
            if not inner.startswith("_") and inspect.isfunction(function):
                yield f"{_call(f'{name}.{inner}', function)}\n"


class _Word:
    """Shown as it is, without quotes."""

    def __init__(self, text: str) -> None:
        self.text = text

    def __repr__(self) -> str:
        return self.text


def _call(name: str, function: Any) -> str:
    """Return a call as one would write it, without what a method is given by itself, and what it does."""
    told = inspect.signature(function)
    own = [_readable(p) for p in told.parameters.values() if p.name not in {"self", "cls"}]
    call = name + str(told.replace(parameters=own, return_annotation=_Word(str(told.return_annotation))))
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
