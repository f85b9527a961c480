"""What a report makes of a fleet whose truth is known: outliers planted, effects counted, priors learnt."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from stillcal.calib_core.accelerometer.parameters import names
from stillcal.replay.fleet import discovery, results_folder
from stillcal.replay.fleet.first_calibration import document, first_calibration
from stillcal.replay.fleet.prior_file import read_prior
from stillcal.replay.fleet.summary.changes import QUANTITIES, Change, changes
from stillcal.replay.fleet.summary.outliers import distances
from stillcal.replay.fleet.summary.page import fleet_page
from stillcal.replay.fleet.summary.report import report
from stillcal.replay.fleet.worker import Examined, Task
from stillcal.replay.formats.errors import TraceError
from stillcal.replay.formats.trace import open_trace
from stillcal.replay.phone.population import population


def fleet_of(folder: Path, values: np.ndarray, models: list[str]) -> Path:
    """Keep results of phones with these parameters (n, 9); every second one has noise unequal on its axes."""
    folder.mkdir()
    results = results_folder.Results(folder / "results", "a test")
    for i, (own, model) in enumerate(zip(values, models, strict=True)):
        path = folder / model / f"phone-{i:03d}" / "recording.csv"
        row = dict(zip((f"accel_bias_{a}" for a in "xyz"), own[:3], strict=True))
        row |= dict(
            zip((f"accel_scale_{a}" for a in ("xx", "yy", "zz", "xy", "xz", "yz")), own[3:], strict=True)
        )
        row |= {"accel_names": list(names(9)), "accel_covariance": (1e-10 * np.eye(9)).ravel().tolist()}
        row |= {"name": str(path.relative_to(folder)), "model": model, "device": f"{model}/{i}"}
        row |= {"status": "calibrated", "attitudes": 20, "accel_rms_residual": 0.002, "findings": i % 2}
        row |= {"rate_hz": 50.0 + i % 3, "rate_jitter": 0.01 * (1 + i % 3)}
        shared = {k: row[k] for k in ("name", "model", "device")}
        found = [{**shared, "effect": "noise_unequal_axes", "sensor": "gyro", "value": [3.0, 4.0]}] * (i % 2)
        results.keep(Task(discovery.FoundRecording(path, row["name"], (), (path,))), Examined(row, found))
    results.finish()
    return folder / "results"


def drawn(n: int, seed: int) -> np.ndarray:
    sizes = np.repeat([0.3, 0.01, 0.004], 3)
    return np.r_[np.zeros(3), np.ones(3), np.zeros(3)] + sizes * np.random.default_rng(seed).standard_normal(
        (n, 9)
    )


def test_a_planted_outlier_is_named_and_nobody_else(tmp_path: Path) -> None:
    values = drawn(60, 4)
    values[17, 4] += 0.2
    found = report(fleet_of(tmp_path / "fleet", values, ["A"] * 30 + ["B"] * 30))
    assert [(o.device, o.parameter) for o in found.outliers] == [("A/17", "S_yy")]
    assert found.recordings == {"calibrated": 60}
    (everyone, *_) = [e for e in found.effects if e.model == "all"]
    assert (everyone.found, everyone.diagnosed, everyone.median) == (30, 60, 5.0)
    assert sum(c.devices for c in found.clusters) == 60
    assert [p.model for p in found.priors] == ["", "A", "B"]


@pytest.mark.parametrize("n", [16, 25, 60])
def test_sound_fleets_have_no_outliers(n: int) -> None:
    """1 % of sound fleets may have one by design; of forty 4 or more would by chance be one in 2000."""
    flagged = 0
    for seed in range(40):
        values = drawn(n, seed)[:, :6]
        flagged += distances(values, np.zeros((n, 6, 6))).outliers.size > 0
    assert flagged <= 3


def test_a_small_fleet_says_what_it_cannot_show(tmp_path: Path) -> None:
    found = report(fleet_of(tmp_path / "fleet", drawn(3, 0), ["A"] * 3))
    assert (found.outliers, found.clusters, found.priors) == ([], [], [])
    assert found.limits == [
        "3 calibrated devices: outliers, clusters and priors need 5",
        "no device has two calibrated recordings: changes cannot be judged",
    ]


def test_what_got_worse_is_named_and_what_changes_as_all_do_is_not() -> None:
    def rows(device: int, names: str, *bias_x: float) -> list[dict[str, Any]]:
        quantities = {c: v for c, _, _, v in QUANTITIES} | {f"{c}_sd": 1e-4 for c, *_ in QUANTITIES}
        one = quantities | {"status": "calibrated", "device": f"phone-{device}", "model": "A"}
        one |= {"temperature_min": 20.0, "temperature_max": 24.0}
        return [one | {"name": n, "accel_bias_x": b} for n, b in zip(names, bias_x, strict=True)]

    ordinary = [r for i in range(6) for r in rows(i, "ab", 0.1, 0.1 + 0.002 * (-1) ** i)]
    drifted, returned = rows(6, "bca", 0.15, 0.3, 0.1), rows(7, "ab", 0.3, 0.1)
    limits: list[str] = []
    found = changes([*ordinary, *drifted, *returned], limits)
    assert [(c.device, c.quantity, c.worse) for c in found] == [
        ("phone-6", "accelerometer bias x", True),
        ("phone-7", "accelerometer bias x", False),
    ]
    assert (found[0].first, found[0].last, found[0].first_c) == (0.1, 0.3, 22.0)
    assert limits == []
    # Without a fleet that shows how much devices ordinarily change, the calibrations' uncertainty decides.
    assert len(changes(ordinary[:2], limits)) == 1
    assert len(limits) == 1
    assert changes(ordinary[:1], limits) == []


def test_the_page_shows_what_got_worse_first_and_escapes_names(tmp_path: Path) -> None:
    found = report(fleet_of(tmp_path / "fleet", drawn(8, 1), ["<b>"] * 8))
    worse = Change("<i>", "A", "accelerometer bias x", "m/s^2", 0.1, 0.3, 9.0, True, "a", "b", None, None)
    page = fleet_page(replace(found, changes=[worse], compared=8), "fleet")
    places = [page.index(text) for text in ("1 of 8 devices got worse", "Devices that got worse", "Priors")]
    assert places == sorted(places)
    assert "<i>" not in page and "&lt;i&gt;" in page and "&lt;b&gt;" in page
    assert "None of 8 devices got worse" in fleet_page(replace(found, compared=8), "fleet")
    assert "got worse" not in fleet_page(found, "fleet")  # nothing could be compared


def test_a_new_phone_is_calibrated_from_its_first_minutes(phones: Path, tmp_path: Path) -> None:
    """From three to six rests, which alone support nothing; the true bias within 4 standard deviations."""
    results = fleet_of(tmp_path / "fleet", drawn(40, 1), ["A"] * 40)
    (tmp_path / "fleet.json").write_bytes(msgspec.json.encode(report(results).document()))
    prior = read_prior(tmp_path / "fleet.json", claimed="LG Nexus 4")
    assert prior.model == "" and prior.devices == 40
    for number, phone in enumerate(population(4)):
        whole = next(p for p in phones.glob(f"*/phone-{number:04d}/*.csv") if "Spoilt" not in str(p))
        lines = whole.read_text().splitlines()[:4000]
        (tmp_path / "new.csv").write_text("\n".join(lines) + "\n")
        fit, rests = first_calibration(open_trace(tmp_path / "new.csv"), prior)
        assert 0 < len(rests) <= 6
        off = np.abs(fit.values[:3] - phone.accel.bias) / np.sqrt(np.diag(fit.covariance)[:3])
        assert off.max() < 4.0
        alone = np.abs(prior.mean[:3] - phone.accel.bias)
        assert np.abs(fit.values[:3] - phone.accel.bias).max() < alone.max()
        told = document(fit, rests, prior)["accelerometer"]
        assert told["n_rests"] == len(rests) and 1 <= told["n_states"] <= len(rests)


def test_what_is_no_report_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "store.json").write_text("{}")
    with pytest.raises(TraceError, match="not a report of stillcal fleet-report"):
        read_prior(tmp_path / "store.json")
