"""What becomes of calibrations that would mislead: `python -m stillcal.replay.trials.misleading`.

A simulated phone is held in 24 attitudes within ten minutes, and something happens that the fit takes no
account of. A case is told where the calibration is refused, marked as degraded, states the change and widens
its interval, or is made anew on the rests since. Silence is the only failure, where the calibration is off
by more than it states.
"""

from __future__ import annotations

import math
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import click
import msgspec
import numpy as np

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.engine.engine import Engine
from stillcal.calib_core.engine.settings import EngineSettings, ScheduleSettings
from stillcal.calib_core.gravity import STANDARD
from stillcal.calib_core.streams.events import Charging, End
from stillcal.calib_core.streams.samples import Samples
from stillcal.replay.phone import load_phone, load_scenario, simulate
from stillcal.replay.phone.simulation import Simulation

MG = STANDARD / 1000

BEGINS_S, AFTERWARDS_S = 300.0, 430.0
"""When something changes: in the middle of the recording, or after a calibration at PLUGGED_S."""

PLUGGED_S = 350.0

AWAY_S = 200.0, 400.0
"""When a bias goes, and when it comes back."""

FAR, LEAST_MG = 3.0, 0.2
"""Standard uncertainties, and mg, by which a bias is off without being what it is stated to be.

The phone's bias wanders by itself (flicker noise, some 0.03 mg), which no interval of a constant holds.
"""

X = np.array([1.0, 0.0, 0.0])

SAID = {
    "only its rests from": "made anew",
    "the bias stepped": "made anew",
    "unknown whether it holds": "warned",
    "widens its interval": "widened",
    "nothing is left to test": "untested",
}
"""What a reason holds, and the verdict that it is."""


@dataclass(frozen=True, slots=True)
class Case:
    """What happens. name: in the table. phones: one after the other, without a word of it.

    bias: (n,) mg on x that is added at times (n,) s. changes: s, when; of several phones when the first one
    ends. live: the phone is charged from PLUGGED_S on, so that it is calibrated before the change, and its
    stream has no end. attitudes: it is held in.
    """

    name: str
    bias: Callable[[Array], Any] = np.zeros_like
    phones: tuple[str, ...] = ("typical",)
    changes: float = 0.0
    live: bool = False
    attitudes: int = 24


def _between(t: Array, begin: float, end: float) -> Any:
    return (t >= begin) & (t < end)


CASES = (
    Case("nothing happens"),
    Case("the bias drifts by 0.5 mg/min", lambda t: 0.5 * t / 60),
    Case("it steps by 3 mg in the middle", lambda t: 3.0 * (t >= BEGINS_S)),
    Case("it steps by 20 mg in the middle", lambda t: 20.0 * (t >= BEGINS_S)),
    Case("it steps by 3 mg and back", lambda t: 3.0 * _between(t, *AWAY_S)),
    Case("it steps by 20 mg and back", lambda t: 20.0 * _between(t, *AWAY_S)),
    Case("it steps by 20 mg near the end", lambda t: 20.0 * (t >= 480.0)),
    Case(
        "it steps by 20 mg after a calibration",
        lambda t: 20.0 * (t >= AFTERWARDS_S),
        changes=AFTERWARDS_S,
        live=True,
    ),
    Case("another phone's recording is appended", phones=("typical", "consumer")),
    Case("a noisier phone's recording is appended", phones=("typical", "mpu6050")),
    Case("another phone goes on, live", phones=("typical", "consumer"), live=True),
    Case("six attitudes for six parameters", attitudes=6),
)


@dataclass(frozen=True, slots=True)
class Verdict:
    """What stillcal said. said: the verdict, "" for nothing. after_s: since the change, live; else NaN.

    error_mg: of the bias at the end, on its worst axis. ratio: that of the axis which is off by most of its
    standard uncertainties, in these. reason: in its own words.
    """

    said: str
    after_s: float
    error_mg: float
    ratio: float
    reason: str

    @property
    def misleads(self) -> bool:
        """Whether the calibration is off by more than it states, and nothing says so."""
        return not self.said and self.ratio > FAR and self.error_mg > LEAST_MG


def judge(case: Case, seed: int) -> Verdict:
    """Let an engine live through a case, and return what it said."""
    engine = Engine(EngineSettings(ScheduleSettings(watch="continuous")))
    lab = load_scenario("lab")
    rest, poses = lab.segments
    scenario = msgspec.structs.replace(
        lab, segments=(rest, msgspec.structs.replace(poses, count=case.attitudes - 1))
    )
    simulations = [simulate(scenario, load_phone(name), seed) for name in case.phones]
    changes = simulations[0].duration if len(simulations) > 1 else case.changes
    last, noticed, plugged = 0.0, math.nan, False
    for gyroscope, accelerometer in _stream(case, simulations):
        events = [Charging(last, True)] if case.live and not plugged and last >= PLUGGED_S else []
        plugged |= bool(events)
        engine.feed(gyroscope, accelerometer, *events)
        last = float(accelerometer.t[-1])
        if case.live and last > changes and engine.state.counters.degradations:
            noticed = last - changes
            break
    if not case.live:
        engine.feed(End(last))
    bias = simulations[-1].truth.accelerometer.bias + MG * float(case.bias(np.array([last]))[0]) * X
    return _verdict(engine, bias, noticed)


def _stream(case: Case, simulations: Sequence[Simulation]) -> Iterator[tuple[Samples, Samples]]:
    """Yield gyroscope and accelerometer of one phone after the other, on one clock."""
    begins = 0.0
    for simulation in simulations:
        for chunk in simulation.chunks():
            assert chunk.gyroscope is not None
            t = chunk.accelerometer.t + begins
            force = chunk.accelerometer.xyz + MG * case.bias(t)[:, None] * X
            yield (
                replace(chunk.gyroscope, t=frozen(chunk.gyroscope.t + begins)),
                replace(chunk.accelerometer, t=frozen(t), xyz=frozen(force)),
            )
        begins += simulation.duration + 10.0


def _verdict(engine: Engine, bias: Array, noticed: float) -> Verdict:
    record, refusal = engine.state.record, engine.state.refusal
    part = None if record is None else record.accelerometer
    if record is None or part is None:
        return Verdict("refused", noticed, math.nan, math.nan, refusal.reason if refusal else "")
    reason = record.acceptance.reason
    said = (
        "degraded"
        if engine.state.counters.degradations
        else next((v for k, v in SAID.items() if k in reason), "")
    )
    assert part.bias_uncertainty is not None
    error = np.abs(part.bias - bias)
    ratio = float((error / part.bias_uncertainty).max())
    return Verdict(said, noticed, float(error.max()) / MG, ratio, reason)


@click.command()
@click.option("--phones", default=5, show_default=True, help="Simulated phones for each case.")
def main(phones: int) -> None:
    """Try each case on some phones; exit code 1 where one misleads."""
    misled = 0
    for case in CASES:
        verdicts = [judge(case, seed) for seed in range(1, phones + 1)]
        said = Counter(v.said or "nothing" for v in verdicts)
        click.echo(f"{case.name}: " + ", ".join(f"{what} {n}" for what, n in said.items()))
        worst = max(verdicts, key=lambda v: (v.misleads, v.ratio))
        fitted = [v for v in verdicts if math.isfinite(v.ratio)]
        if fitted:
            off, ratio = max(v.error_mg for v in fitted), max(v.ratio for v in fitted)
            click.echo(f"  the bias is off by {off:.2g} mg, {ratio:.2g} standard uncertainties, at most")
        if case.live:
            click.echo(f"  said {max(v.after_s for v in verdicts):.0f} s after the change at most")
        click.echo(f"  {worst.reason}")
        misled += sum(v.misleads for v in verdicts)
    click.echo(f"misleading without a word: {misled}")
    sys.exit(misled > 0)


if __name__ == "__main__":
    main()
