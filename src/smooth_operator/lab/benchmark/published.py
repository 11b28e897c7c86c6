"""The paper's table, to compare with a benchmark: other data, another machine."""

from __future__ import annotations

from typing import Final

PAPER_TABLE: Final[dict[str, dict[str, float]]] = {
    "DexPilot": {
        "cosine_similarity": 0.9932, "scale_ratio": 0.885, "motion_preservation": 0.727,
        "flatness": 7.71e-6, "workspace_utilisation": 0.261, "latency_ms.p50": 4.905,
    },
    "GeoRT": {
        "cosine_similarity": 0.9799, "scale_ratio": 1.050, "motion_preservation": 0.695,
        "flatness": 3.01e-6, "workspace_utilisation": 0.352, "latency_ms.p50": 1.410,
    },
    "Hybrid": {
        "cosine_similarity": 0.9879, "scale_ratio": 0.891, "motion_preservation": 0.675,
        "flatness": 6.17e-6, "workspace_utilisation": 0.225, "latency_ms.p50": 9.892,
    },
    "SBR": {
        "cosine_similarity": 0.9969, "scale_ratio": 0.877, "motion_preservation": 0.776,
        "flatness": 7.17e-7, "workspace_utilisation": 0.210, "latency_ms.p50": 3.664,
    },
}  # fmt: skip
"""Source: the paper's table of simulation metrics. Its latency is one number a method; it stands
here under the median."""

PAPER_NOTE: Final = (
    "The paper's figures are from other data (14 operators at about 100 Hz, mimic P0.50 right, an "
    "RTX 4090) and follow its own definitions: read them as a reference, not as a row to beat."
)
