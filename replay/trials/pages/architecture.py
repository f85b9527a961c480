"""The page of the architecture: which package stands on which, read from the imports.

`python -m stillcal.replay.trials.pages.architecture > docs/architecture.md` writes it.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator, Mapping
from importlib.resources import files
from pathlib import Path

import click

LAYERS = ("replay", "daemon", "calib_core")
"""From the top to the bottom; a layer imports only those below it."""

HEAD = """\
# How the code is laid out

*For people who change the code.*

Made from the code by `python -m stillcal.replay.trials.pages.architecture > docs/architecture.md`; a test
holds it against the code, and `make check` holds the code against the layers in `pyproject.toml`.

There are three layers. `calib_core` computes and touches nothing: arrays go in, values come out. `daemon` is
the only layer that keeps running and talks to the world: serial lines, sockets, systemd, the store. `replay`
reads recordings, simulates a phone, diagnoses, and proves. A layer imports only those below it, and inside a
layer a package, or a single file of the layer such as `settings`, imports only those on lower lines:
"""

MIDDLE = """\
What flows is one thing everywhere: runs of samples of one sensor with its own time stamps
(`calib_core/streams/samples.py`) and events (`calib_core/streams/events.py`) go into the engine, and actions
(`calib_core/engine/actions.py`) come out:

    source -> wire or format -> samples, events -> Engine.feed -> actions -> service -> store, socket

The engine runs on sample time and never reads a clock. A day lived over a serial line and the same day
replayed from a file therefore give the same calibration, to the bit.

## Packages

| package | what it holds | imports |
|---|---|---|
"""

TAIL = """
`stillcal/api.py` is the public Python interface ([api.md](api.md)), above all three layers.
`stillcal/__init__.py` imports it when it is used, so that the daemon does not. `config` holds data files.

The commands are imported when they are called, so that the daemon, which runs for months, holds only numpy,
pyserial, msgspec, click and asyncvarlink. `replay.studies`, `replay.real_data` and `replay.trials` prove the
product. Only `stillcal evaluate` imports one of them, and they come with a checkout, not with the installed
package.

Two more rules are import contracts: the simulated phone shares no formula with the estimators, or the same
mistake would hide in both; the examiner of the blind test shares none with the diagnosis.

## Where to begin reading

For a given task, [tasks.md](tasks.md) names the place; [glossary.md](glossary.md) explains the words.

- `calib_core/engine/engine.py`: `feed`, `wants`, and what follows from them.
- `calib_core/static/detector.py`: the rests. `calib_core/accelerometer/fit.py` and
  `calib_core/gyroscope/fit.py`: the fits. `calib_core/calibration/drift_check.py`: the hourly check.
  `calib_core/calibration/acceptance.py`: the acceptance rule.
- `daemon/app.py`: the daemon from its start to its end; `daemon/service/phone_session.py`: one phone's line.
- `replay/runner.py`: the same engine on a recording, in a hundred lines.
- `calib_core/diagnosis/diagnose.py`: the diagnosis, stage by stage in `examine`; `examination.py` is what the
  stages leave. `calib_core/diagnosis/comparison/compare.py`: two recordings, or one and its simulation.
"""

Imports = Mapping[str, frozenset[str]]


def page() -> str:
    """Return the page in Markdown."""
    root = Path(str(files("stillcal")))
    modules = dict(_modules(root))
    imports = {name: _imports(path, modules) for name, path in modules.items()}
    drawing = "\n".join(_drawn(layer, imports) for layer in LAYERS)
    rows = "".join(_row(name, path, imports) for name, path in modules.items() if path.name == "__init__.py")
    return f"{HEAD}\n```\n{drawing}```\n\n{MIDDLE}{rows}{TAIL}"


def _modules(root: Path) -> Iterator[tuple[str, Path]]:
    """Yield the name below `stillcal` and the file of every module, package by package."""
    for layer in sorted(LAYERS):
        for path in sorted((root / layer).rglob("*.py")):
            name = ".".join(path.relative_to(root).with_suffix("").parts)
            yield name.removesuffix(".__init__"), path


def _imports(path: Path, modules: Mapping[str, Path]) -> frozenset[str]:
    """Return the modules of ours that a file names in any import."""
    named: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and node.module:
            named |= {f"{node.module}.{alias.name}" for alias in node.names}
        elif isinstance(node, ast.Import):
            named |= {alias.name for alias in node.names}
    ours = (name.removeprefix("stillcal.") for name in named if name.startswith("stillcal."))
    return frozenset(found for name in ours if (found := _module_of(name, modules)))


def _module_of(name: str, modules: Mapping[str, Path]) -> str:
    while name and name not in modules:
        name = name.rpartition(".")[0]
    return name


def _of_package(package: str, imports: Imports) -> frozenset[str]:
    """Return the packages that the files of one package, but not of those inside it, import."""
    packages = {name.rpartition(".")[0] for name in imports} | {package}
    own = [name for name in imports if _package_of(name, packages) == package]
    to = {_package_of(target, packages) for name in own for target in imports[name]}
    return frozenset(to - {package, ""})


def _package_of(module: str, packages: set[str]) -> str:
    return module if module in packages else module.rpartition(".")[0]


def _row(package: str, path: Path, imports: Imports) -> str:
    text = ast.get_docstring(ast.parse(path.read_text())) or ""
    first = " ".join(text.split("\n\n")[0].split())
    to = ", ".join(f"`{name}`" for name in sorted(_of_package(package, imports)))
    return f"| `{package}` | {first} | {to} |\n"


def _drawn(layer: str, imports: Imports) -> str:
    """Return the children of a layer line by line, each above all that it imports."""

    def child(module: str) -> str:
        return module.split(".")[1] if module.startswith(f"{layer}.") else ""

    below: dict[str, set[str]] = {child(name): set() for name in imports if child(name)}
    for name, targets in imports.items():
        if child(name):
            below[child(name)] |= {child(t) for t in targets} - {child(name), ""}
    lines: list[list[str]] = []
    while below:
        free = sorted(name for name, to in below.items() if not to & below.keys())
        if not free:
            raise ValueError(f"{layer}: packages import each other in a ring: {', '.join(sorted(below))}")
        lines.append(free)
        below = {name: to for name, to in below.items() if name not in free}
    first, *rest = ["  ".join(line) for line in reversed(lines)]
    return "\n".join([f"{layer:12s}{first}", *(f"{'':12s}{line}" for line in rest), ""])


if __name__ == "__main__":
    click.echo(page(), nl=False)
