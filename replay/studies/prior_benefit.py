"""What a prior from a fleet is worth to a new phone: error against number of rests, each device left out.

`python -m stillcal.replay.studies.prior_benefit [--hhar FOLDER]` draws phones, calibrates each from its first
rests with and without what the others tell, and prints the errors; with FOLDER the same for the real devices
of hhar_still. The error is that of gravity's norm over all attitudes, or for real devices over the faces that
were not used. The bound is what no linear estimate of a phone from this population goes below on average.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path

import click
import msgspec
import numpy as np

from stillcal.calib_core.accelerometer import fit as accelerometer
from stillcal.calib_core.accelerometer import observability
from stillcal.calib_core.accelerometer import prior as fleet_prior
from stillcal.calib_core.accelerometer.prior import FleetPrior, Population
from stillcal.calib_core.arrays import Array
from stillcal.calib_core.errors import NotSupported
from stillcal.calib_core.gravity import STANDARD
from stillcal.calib_core.model import SensorModel
from stillcal.daemon.cli.progress import progress
from stillcal.replay.formats.hhar_still import DeviceRecordings, read
from stillcal.replay.phone import Phone, draw_rests
from stillcal.replay.phone.population import MODELS, population
from stillcal.replay.studies.methods.device_faces import calibrate_devices

RESTS = (0, 1, 2, 3, 4, 6, 8, 12, 20)
FAMILY_SD = 0.35  # m/s^2, of the bias that a model's phones share in the second population
_OWN_SHARE = 0.3  # of a phone's own bias that is left where its model has one
_WANDER = 0.0005  # m/s^2, of a population's phone from rest to rest, in the median
SCATTER = 0.01  # m/s^2, of real phones' rests, where six faces leave nothing to tell it by
_LONG = 30  # rests that each other phone of the fleet was calibrated from
_BOOTSTRAPS, _INTERVAL = 2000, (0.025, 0.975)
_DRAWN = 2000  # phones that tell the population's true covariance

Arms = dict[str, float]
"""Squared error by way of calibrating, (m/s^2)^2."""


@dataclass(frozen=True, slots=True, eq=False)
class Device:
    """A device of the fleet: rests in the order they came, its own full calibration, and how to judge one.

    forces, uncertainties: (n, 3) m/s^2. values, covariance: of its full calibration; scatter: m/s^2, what
    that left at rest. error: mean square, over attitudes that were not used, of the norm that a model leaves,
    (m/s^2)^2. shift: (3,) m/s^2, bias that its model's phones share, 0 where that is not known.
    """

    model: int
    forces: Array
    uncertainties: Array
    values: Array
    covariance: Array
    scatter: float
    error: Callable[[SensorModel], float]
    shift: Array


@dataclass(frozen=True, slots=True)
class Point:
    """Rms error of one way of calibrating at one number of rests, with a 95 % interval over devices, m/s^2.

    calibrated: share of devices that this way calibrates at all; the others keep the factory's. ratio: of
    the rms to that of the datasheet's prior, with its 95 % interval over the same devices.
    """

    way: str
    rests: int
    rms: float
    low: float
    high: float
    calibrated: float
    ratio: tuple[float, float, float]


def left_out(devices: Sequence[Device]) -> Iterator[tuple[Device, FleetPrior, FleetPrior]]:
    """Yield each device with what the others say of any device, and of one of its model."""
    for k, device in enumerate(devices):
        others = [d for i, d in enumerate(devices) if i != k]
        known = sorted({d.model for d in others})
        learnt = fleet_prior.learn(
            [d.values for d in others],
            [d.covariance for d in others],
            [known.index(d.model) for d in others],
            float(np.median([d.scatter for d in others])),
        )
        known_model = known.index(device.model) if device.model in known else None
        yield device, _flat(learnt), learnt.prior(known_model)


def _flat(learnt: Population) -> FleetPrior:
    """Return what is expected of a device of which not even the model is known."""
    share = learnt.devices / learnt.devices.sum()
    mean = share @ learnt.model_means
    off = learnt.model_means - mean
    return FleetPrior(mean, learnt.within + np.einsum("g,gi,gj->ij", share, off, off), learnt.scatter)


def ways(device: Device, rows: Sequence[int], fleet: FleetPrior, model: FleetPrior, g: float) -> Arms:
    """Return the squared errors of every way of calibrating from these of its rests; NaN where it refuses."""
    forces, sd = device.forces[list(rows)], device.uncertainties[list(rows)]
    errors = {"factory": device.error(SensorModel.identity()), "rests alone": np.nan}
    with suppress(NotSupported):
        errors["rests alone"] = device.error(accelerometer.fit(forces, sd, g).model)
    for name, prior in (
        ("datasheet", fleet_prior.SOUND_PHONES),
        ("fleet", fleet),
        ("fleet, by model", model),
    ):
        errors[name] = device.error(fleet_prior.fit(forces, sd, g, prior).model)
    return errors


def points(errors: dict[int, list[list[Arms]]], seed: int = 0) -> list[Point]:
    """Summarise squared errors, by number of rests a list of devices with a list of tries each.

    Where a way refuses, the phone keeps the factory's calibration; that is its error then.
    """
    rng, summary = np.random.default_rng(seed), []
    for rests, devices in sorted(errors.items()):
        draws = rng.integers(len(devices), size=(_BOOTSTRAPS, len(devices)))
        means = {way: np.array([_mean(tries, way) for tries in devices]) for way in devices[0][0]}
        base = means["datasheet"]
        for way, own in means.items():
            low, high = np.sqrt(np.quantile(own[draws].mean(axis=1), _INTERVAL))
            ratios = np.sqrt(own[draws].mean(axis=1) / base[draws].mean(axis=1))
            least, most = np.quantile(ratios, _INTERVAL)
            ratio = (float(np.sqrt(own.mean() / base.mean())), float(least), float(most))
            done = np.mean([not np.isnan(t[way]) for tries in devices for t in tries])
            rms = float(np.sqrt(own.mean()))
            summary.append(Point(way, rests, rms, float(low), float(high), float(done), ratio))
    return summary


def _mean(tries: list[Arms], way: str) -> float:
    return float(np.mean([t["factory"] if np.isnan(t[way]) else t[way] for t in tries]))


def simulated(n: int, seed: int, families: float = 0.0) -> list[Device]:
    """Draw n phones lying about as phones do, each calibrated from many spread rests of its own.

    families: sd in m/s^2 of a bias that all phones of a model share, on top of the population's own.
    """
    phones = population(n, seed)
    names = sorted({m.device for m in MODELS})
    shared = np.random.default_rng(seed).normal(0.0, families, (len(names), 3)) if families else None
    devices = []
    for i, phone in enumerate(phones):
        model = names.index(phone.claims.device or names[0])
        own = phone if shared is None else _shifted(phone, shared[model])
        shift = np.zeros(3) if shared is None else shared[model]
        devices.append(_simulated(own, model, seed * 100_003 + i, shift))
    return devices


def _shifted(phone: Phone, by: Array) -> Phone:
    x, y, z = (float(b) for b in _OWN_SHARE * np.asarray(phone.accel.bias) + by)
    return msgspec.structs.replace(phone, accel=msgspec.structs.replace(phone.accel, bias=(x, y, z)))


def _simulated(phone: Phone, model: int, seed: int, shift: Array) -> Device:
    full = draw_rests(phone, _LONG, seed)
    fit = accelerometer.fit(full.forces, full.uncertainties, full.gravity, parameters=9)
    first = draw_rests(phone, max(RESTS), seed + 50_000_017, attitudes="lying")
    up = observability.sphere()
    raw = full.gravity * up @ np.asarray(phone.accel.scale).T + np.asarray(phone.accel.bias)

    def error(model_found: SensorModel) -> float:
        return float(np.mean((np.linalg.norm(model_found.apply(raw), axis=1) - full.gravity) ** 2))

    sd = first.white_uncertainties
    covariance = np.asarray(fit.total_covariance)
    return Device(model, first.forces, sd, fit.values, covariance, fit.rms_residual, error, shift)


def real(folder: Path) -> list[Device]:
    """Return the devices of hhar_still that lay on all six faces, calibrated from them, 6 parameters."""
    outcomes = [o for o in calibrate_devices(read(folder)) if o.calibration is not None]
    names = sorted({o.recordings.model for o in outcomes})
    return [_real(o.recordings, names.index(o.recordings.model)) for o in outcomes]


def _real(recordings: DeviceRecordings, model: int) -> Device:
    raw, sd = recordings.means, recordings.uncertainties
    fit = accelerometer.fit(raw, sd, STANDARD, parameters=6)
    values, covariance = fleet_prior.expanded(fit.values, fit.total_covariance)

    def error(found: SensorModel) -> float:
        raise NotImplementedError("a real device is judged on the faces that were not used")

    return Device(model, raw, sd, values, covariance, SCATTER, error, np.zeros(3))


def of_simulated(
    devices: Sequence[Device], truth: FleetPrior, tick: Callable[[int], None], rests: Sequence[int] = RESTS
) -> list[Point]:
    """Take each device's first rests, in the order they came. truth: of the population they are from."""
    errors: dict[int, list[list[Arms]]] = {n: [] for n in rests}
    for done, (device, fleet, model) in enumerate(left_out(devices)):
        for n, tried in errors.items():
            own = replace(truth, mean=truth.mean + np.r_[device.shift, np.zeros(6)])
            known = fleet_prior.fit(device.forces[:n], device.uncertainties[:n], STANDARD, own)
            variances = fleet_prior.norm_variances(observability.sphere(), known.covariance, STANDARD)
            tried.append(
                [ways(device, range(n), fleet, model, STANDARD) | {"bound": float(variances.mean())}]
            )
        tick(done + 1)
    return points(errors)


def true_prior(families: float = 0.0) -> FleetPrior:
    """Return the mean and covariance of the population itself, about what a model's phones share."""
    values = []
    for phone in population(_DRAWN, 1):
        scale = np.asarray(phone.accel.scale)
        size, vectors = np.linalg.eigh(np.linalg.inv(scale @ scale.T))
        correction = (vectors * np.sqrt(size)) @ vectors.T  # symmetric, with the norms of the true one
        bias = np.asarray(phone.accel.bias) * (_OWN_SHARE if families else 1.0)
        values.append(np.r_[bias, np.diag(correction), correction[np.triu_indices(3, 1)]])
    return FleetPrior(np.mean(values, axis=0), np.cov(np.array(values).T), _WANDER)


def of_real(
    devices: Sequence[Device], tick: Callable[[int], None], faces: Sequence[int] = range(6)
) -> list[Point]:
    """Take every choice of so many of a device's faces, and judge on those left."""
    errors: dict[int, list[list[Arms]]] = {n: [] for n in faces}
    for done, (device, fleet, model) in enumerate(left_out(devices)):
        for n, tried in errors.items():
            tried.append([_on_others(device, rows, fleet, model) for rows in combinations(range(6), n)])
        tick(done + 1)
    return points(errors)


def _on_others(device: Device, rows: Sequence[int], fleet: FleetPrior, model: FleetPrior) -> Arms:
    others = device.forces[[i for i in range(len(device.forces)) if i not in rows]]

    def error(found: SensorModel) -> float:
        return float(np.mean((np.linalg.norm(found.apply(others), axis=1) - STANDARD) ** 2))

    return ways(replace(device, error=error), rows, fleet, model, STANDARD)


def table(points: Sequence[Point]) -> list[str]:
    """Return the points as lines of a Markdown table: rms in m/s^2, its 95 % interval over devices."""
    names = list(dict.fromkeys(p.way for p in points))
    lines = ["| rests | " + " | ".join(names) + " |", "|---|" + "---|" * len(names)]
    for n in sorted({p.rests for p in points}):
        row = [next(p for p in points if p.rests == n and p.way == way) for way in names]
        lines.append(f"| {n} | " + " | ".join(_cell(p) for p in row) + " |")
    return lines


def _cell(point: Point) -> str:
    share = "" if point.calibrated == 1.0 else f", {point.calibrated:.0%} calibrated"
    return f"{point.rms:.4f} ({point.low:.4f} to {point.high:.4f}{share})"


def gains(points: Sequence[Point]) -> list[str]:
    """Return as a Markdown table what the fleet adds to the datasheet: ratios of rms errors."""
    names = ("fleet", "fleet, by model")
    lines = ["| rests | " + " | ".join(f"{n} / datasheet" for n in names) + " |", "|---|---|---|"]
    for n in sorted({p.rests for p in points}):
        row = [next(p.ratio for p in points if p.rests == n and p.way == way) for way in names]
        lines.append(f"| {n} | " + " | ".join(f"{r:.2f} ({a:.2f} to {b:.2f})" for r, a, b in row) + " |")
    return lines


@click.command()
@click.option("--phones", default=80, type=click.IntRange(10), show_default=True)
@click.option("--seed", default=0, type=click.IntRange(0), show_default=True)
@click.option(
    "--hhar", type=click.Path(path_type=Path, exists=True, file_okay=False), help="The still experiment."
)
def main(phones: int, seed: int, hhar: Path | None) -> None:
    """Print the error of a first calibration against the number of rests, with and without a fleet."""
    for title, families in (
        ("Phones as the population has them", 0.0),
        ("Phones alike within a model", FAMILY_SD),
    ):
        with progress(title, phones, quiet=False) as step:
            summary = of_simulated(simulated(phones, seed, families), true_prior(families), step)
        click.echo("\n".join([f"\n{title}, {phones} simulated\n", *table(summary), "", *gains(summary)]))
    if hhar is not None:
        devices = real(hhar)
        with progress("hhar_still", len(devices), quiet=False) as step:
            summary = of_real(devices, step)
        click.echo(
            "\n".join([f"\nDevices of hhar_still, {len(devices)}\n", *table(summary), "", *gains(summary)])
        )


if __name__ == "__main__":
    main()
