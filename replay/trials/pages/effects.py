"""The page of the slow effects, from their classes.

`python -m stillcal.replay.trials.pages.effects > docs/effects.md` writes it.
"""

from __future__ import annotations

from collections.abc import Iterator

from stillcal.calib_core.diagnosis.effects.catalogue import GROUP, own_effects
from stillcal.calib_core.diagnosis.model.effect import Effect
from stillcal.calib_core.diagnosis.model.records import NAME

HEAD = """\
# Slow effects that the diagnosis knows

*For people who look up what a finding means, or write an effect of their own.*

Made from the effects' own classes by `python -m stillcal.replay.trials.pages.effects > docs/effects.md`; a
test holds this page against them. What single samples and stamps show (limits, steps, jitter, ...) is in
[direct_checks.md](direct_checks.md).

A parameter's *size* is the standard deviation of its prior: what physics makes of it at most. T is
temperature, t the time since the recording began.
"""

OWN = f"""\
## Physics of your own

Write a class and name it in your package's `pyproject.toml`:

```toml
[project.entry-points."{GROUP}"]
gyro_bias_breeze = "breeze:Breeze"
```

```python
import numpy as np
from stillcal.calib_core.diagnosis.model.effect import Effect, Linear, on_axes


class Breeze(Effect):
    name = "gyro_bias_breeze"
    sensor = "gyro"
    follows = "the air conditioner"
    parameters = (Linear("swing", "rad/s", 3, 0.002),)  # name, unit, how many, size
    sentence = "The gyroscope's bias swings with the air conditioner on {{axes}}."
    equation = "bias(t) = bias + swing sin(2 pi t / 600 s)"
    remedy = "switch the air conditioner off"

    def response(self, moments, grid):
        return on_axes(np.sin(2.0 * np.pi * moments.age / 600.0))
```

`response` returns what a unit of each parameter adds to the sensor's three outputs, (n, 3, k) in m/s^2 or
rad/s, at the moments given: `moments.age` s, `.temperature` K about its mean, `.charging` 0 to 1, `.force`
m/s^2, `.rate` rad/s, each (n,) or (n, 3). Once the package is installed the effect is sought in every
recording, reported with its sentence and equation, put into a given simulation, and written to a phone file
as `other_physics`. An effect with a shape parameter gives its values in `points` and `finer`; see
`calib_core/diagnosis/effects/warmup.py`.
"""


def page() -> str:
    """Return the whole page."""
    return "\n".join([HEAD, *_tables(), OWN])


def _tables() -> Iterator[str]:
    for sensor, name in NAME.items():
        yield f"## {name.capitalize()}\n"
        yield "| effect | follows | equation | parameters: unit, size | looks like | what tells |"
        yield "|---|---|---|---|---|---|"
        most: dict[str, Effect] = {}
        for effect in own_effects():
            if effect.sensor == sensor:
                known = most.setdefault(effect.name, effect)
                if len(effect.parameters) > len(known.parameters):
                    most[effect.name] = effect
        yield from (_row(effect) for effect in most.values())
        yield ""


def _row(effect: Effect) -> str:
    sizes = "; ".join(f"{p.name}: {p.unit}, {p.size:g}" for p in effect.parameters)
    looks = ", ".join(f"`{name}`" for name in effect.look_alikes)
    equation = effect.equation.replace("|", "\\|")
    return f"| `{effect.name}` | {effect.follows} | {equation} | {sizes} | {looks} | {effect.decides} |"


if __name__ == "__main__":
    print(page(), end="")
