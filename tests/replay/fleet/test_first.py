"""A new phone's first calibration takes a prior only where it means something, and is the phone's."""

from __future__ import annotations

import copy
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from stillcal.calib_core.accelerometer import prior as fleet_prior
from stillcal.calib_core.accelerometer.prior import NOMINAL, FleetPrior
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.daemon.cli.exits import TOO_LITTLE
from stillcal.daemon.cli.main import cli
from stillcal.replay.commands.fleet import parameter_line
from stillcal.replay.fleet.first_calibration import first_calibration
from stillcal.replay.fleet.prior_file import few_devices, read_prior
from stillcal.replay.fleet.summary.report import prior_document
from stillcal.replay.formats.errors import TraceError
from stillcal.replay.formats.trace import open_trace
from stillcal.replay.formats.writer import TraceWriter
from stillcal.replay.outcome import current_in_store
from stillcal.replay.phone import load_phone, load_scenario, simulate

SIZES = np.repeat([0.4, 0.015, 0.005], 3)
PRIOR = FleetPrior(NOMINAL, np.diag(SIZES**2), 0.01, 40)
NEXUS = replace(PRIOR, model="LG Nexus 4", devices=12)


def written(folder: Path, *priors: Any, schema: int = 1) -> Path:
    path = folder / "fleet.json"
    path.write_text(json.dumps({"schema": schema, "priors": priors}))
    return path


def spoilt(place: tuple[str | int, ...], value: Any) -> dict[str, Any]:
    """A prior as a report holds it, with one value of it replaced."""
    document: Any = copy.deepcopy(prior_document(PRIOR))
    inside = document
    for key in place[:-1]:
        inside = inside[key]
    inside[place[-1]] = value
    return dict(document)


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Samples:
    """Ten minutes of poses by hand of a phone with 40, 30, 20 mg of bias and 1 % of scale."""
    return simulate(load_scenario("lab"), load_phone("typical"), 7).whole().accelerometer


def recording(folder: Path, samples: Samples) -> Path:
    path = folder / "new.csv"
    with TraceWriter(path, gyroscope=False) as writer:
        writer.write(samples, Samples.empty(Sensor.GYROSCOPE))
    return path


@pytest.mark.parametrize(
    ("place", "value", "said"),
    [
        (("mean", 0), None, "Expected `float`, got `null`"),
        (("mean",), [0.0] * 6, "its mean has 6 numbers"),
        (("mean",), [1.0] * 3 + [0.0] * 6, "its scale is 0 to 0"),
        (("mean", 0), 40.0, "its bias is 40 m/s"),
        (("covariance", 1, 1), -0.16, "its variance of b_y is -0.16"),
        (("covariance", 0, 0), 0.0, "its variance of b_x is 0"),
        (("covariance", 0, 1), 0.1, "not symmetric"),
        (("covariance", 8), [0.0] * 3, "not 9 by 9"),
        (("sd", 0), -0.4, "its standard deviations do not agree"),
        (("scatter",), -0.01, "its scatter is -0.01"),
        (("devices",), -4, "-4 devices"),
        (("names",), ["b_x"] * 9, "its parameters are b_x"),
    ],
)
def test_a_prior_that_means_nothing_is_refused(
    place: tuple[str | int, ...], value: Any, said: str, tmp_path: Path
) -> None:
    path = written(tmp_path, spoilt(place, value))
    with pytest.raises(TraceError, match=said) as refused:
        read_prior(path)
    assert str(refused.value).startswith(f"{path}: ") and "stillcal fleet-report" in str(refused.value)
    assert "\n" not in str(refused.value)


def test_spreads_that_no_sensor_can_have_together_are_refused(tmp_path: Path) -> None:
    document = spoilt(("covariance", 0, 1), 0.2)
    document["covariance"][1][0] = 0.2  # a correlation of 1.25
    with pytest.raises(TraceError, match="not positive definite"):
        read_prior(written(tmp_path, document))


def test_a_prior_not_finite_and_another_schema_are_refused(tmp_path: Path) -> None:
    path = written(tmp_path, spoilt(("mean", 0), float("nan")))
    with pytest.raises(TraceError, match=r"not a report of stillcal fleet-report: .*; make one"):
        read_prior(path)
    with pytest.raises(TraceError, match="its schema is 2, but only 1 can be read"):
        read_prior(written(tmp_path, prior_document(PRIOR), schema=2))


def test_what_a_report_writes_is_read_back(tmp_path: Path) -> None:
    values = NOMINAL + SIZES * np.random.default_rng(4).standard_normal((30, 9))
    own = np.broadcast_to(np.diag((0.1 * SIZES) ** 2), (30, 9, 9))
    learnt = fleet_prior.learn(values, own, np.arange(30) // 10).prior(1, "LG Nexus 4")
    found = read_prior(written(tmp_path, prior_document(learnt)), "LG Nexus 4")
    np.testing.assert_allclose(found.mean, learnt.mean)
    np.testing.assert_allclose(found.covariance, learnt.covariance)
    assert (found.scatter, found.devices, found.model) == (learnt.scatter, 30, "LG Nexus 4")


def test_the_prior_is_the_phones_models_or_of_any_model_and_no_others(tmp_path: Path) -> None:
    both = written(tmp_path, prior_document(PRIOR), prior_document(NEXUS))
    assert read_prior(both).model == read_prior(both, None, "HTC One").model == ""
    assert read_prior(both, "LG Nexus 4").model == read_prior(both, None, "LG Nexus 4").model == NEXUS.model
    with pytest.raises(TraceError, match=r"no prior of 'HTC One'; give one of its models \('LG Nexus 4'\)"):
        read_prior(both, "HTC One")
    nexus = written(tmp_path, prior_document(NEXUS))
    with pytest.raises(TraceError, match=r"no prior of 'HTC One' nor of any model; .* --model: 'LG Nexus 4'"):
        read_prior(nexus, None, "HTC One")
    twice = written(tmp_path, prior_document(NEXUS), prior_document(NEXUS))
    with pytest.raises(TraceError, match="more than one prior of LG Nexus 4"):
        read_prior(twice, "LG Nexus 4")


def test_a_recording_of_another_phone_or_unit_is_refused(lab: Samples, tmp_path: Path) -> None:
    """The same rests: 40 mg of bias and 1 % of scale are the prior's, a tenth more of everything is not."""
    fit, rests = first_calibration(open_trace(recording(tmp_path, lab)), PRIOR)
    assert len(rests) > 20
    np.testing.assert_allclose(fit.values[:3], [0.392266, -0.2941995, 0.196133], atol=0.02)
    other = recording(tmp_path, replace(lab, xyz=1.1 * lab.xyz))
    with pytest.raises(TraceError, match=r"contradict the prior of any model: S_.. is -\d.* stillcal replay"):
        first_calibration(open_trace(other), PRIOR)


def test_a_phone_of_the_fleet_is_hardly_ever_refused() -> None:
    """Of 300 phones from the prior itself, each shown 20 rests, none is: one in a million would be."""
    rng = np.random.default_rng(5)
    for values in NOMINAL + SIZES * rng.standard_normal((300, 9)):
        up = rng.standard_normal((20, 3))
        up *= 9.80665 / np.linalg.norm(up, axis=1, keepdims=True)
        scale = (fleet_prior.basis(9) @ values)[3:].reshape(3, 3)
        raw = up @ np.linalg.inv(scale).T + values[:3]
        found = fleet_prior.surprise(fleet_prior.fit(raw, np.full(raw.shape, 0.01), 9.80665, PRIOR), PRIOR)
        assert found.squared < found.limit


def test_without_a_rest_there_is_no_calibration(lab: Samples, tmp_path: Path) -> None:
    """A table of rests read as samples, or a phone that was never put down, is not the prior said again."""
    moved = recording(tmp_path, lab[:50])
    prior, out = written(tmp_path, prior_document(PRIOR)), tmp_path / "first.json"
    result = CliRunner().invoke(
        cli, ["fleet-first", str(moved), "--prior", str(prior), "--json", str(out)], catch_exceptions=False
    )
    assert result.exit_code == TOO_LITTLE and not out.exists()
    assert result.output.startswith(f"stillcal: {moved}: no rest was found; needed: ")
    assert result.output.count("\n") == 1


def test_a_first_calibration_is_stored_and_a_prior_of_few_devices_is_warned_of(
    lab: Samples, tmp_path: Path
) -> None:
    path, store = recording(tmp_path, lab), tmp_path / "store.json"
    few = written(tmp_path, prior_document(replace(PRIOR, devices=16)))
    said = CliRunner().invoke(cli, ["fleet-first", str(path), "--prior", str(few), "--store", str(store)])
    assert said.exit_code == 0, said.output
    assert said.stderr.count("learnt from 16 devices: below 20") == 1
    kept = current_in_store(store)
    assert kept.accelerometer is not None and kept.accelerometer.with_prior
    np.testing.assert_allclose(kept.accelerometer.bias, [0.392266, -0.2941995, 0.196133], atol=0.02)
    assert few_devices(replace(PRIOR, devices=20)) is None
    assert few_devices(replace(NEXUS, devices=30, of_model=5)) is None
    assert "leans on the other models" in (few_devices(replace(NEXUS, devices=30, of_model=4)) or "")


def test_no_uncertainty_is_rounded_to_nothing() -> None:
    assert "+0.99031 ± 1.6e-06 " in parameter_line("S_xx", 0.990312, 1.63e-6, 0.0)
