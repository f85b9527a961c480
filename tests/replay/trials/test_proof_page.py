"""The proof's table: shares in per cent, d' as it is, what no solver has left out."""

from __future__ import annotations

from stillcal.replay.trials.pages.proof import table

SCORES = [
    {
        "solver": "diagnosis",
        "right": {"hits": 3, "n": 4, "value": 0.75},
        "lines": [
            {
                "what": "alarms",
                "value": 0.25,
                "low": 0.01,
                "high": 0.8,
                "n": 4,
                "bar": "<= 1%",
                "holds": False,
            },
            {"what": "  of them", "value": 1.0, "low": 0.1, "high": 1.0, "n": 1, "bar": "", "holds": None},
            {
                "what": "d' of 90 % detection",
                "value": 9.0,
                "low": 7.0,
                "high": None,
                "n": 4,
                "bar": "",
                "holds": None,
            },
            {"what": "  of them", "value": 0.5, "low": 0.1, "high": 0.9, "n": 4, "bar": "", "holds": None},
            {"what": "not tried", "value": None, "low": None, "high": None, "n": 0, "bar": "", "holds": None},
        ],
    },
    {"solver": "sparse_regression", "right": {"hits": 0, "n": 4, "value": 0.0}, "lines": []},
]


def test_scores_become_a_table() -> None:
    assert list(table(SCORES)) == [
        "| score | diagnosis | sparse regression | n | bar | holds |",
        "| --- | --- | --- | --- | --- | --- |",
        "| alarms | 25.0 % (1 to 80) | - | 4 | <= 1% | **no** |",
        "| - of them | 100.0 % (10 to 100) | - | 1 |  |  |",
        "| d' of 90 % detection | 9.0 (7.0 and more) | - | 4 |  |  |",
        "| - of them | 50.0 % (10 to 90) | - | 4 |  |  |",
        "\nWhole answer right, of 4 cases: diagnosis 75.0 %, sparse regression 0.0 %.",
    ]
